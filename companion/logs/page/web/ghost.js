// Simulations put back onto the boat every so many seconds: what they say at an instant, and where they have been.

const FIELDS = ["north_m", "east_m", "psi_rad", "u_m_s", "v_m_s", "r_rad_s"];
const NOWHERE = Object.fromEntries(FIELDS.map((name) => [name, null]));

/** One ghost: {name, step_s, pieces: [{t_s, x: [[north, east, psi, u, v, r], ...], off_m: [...]}]}, t_s on the boat's clock. */
export class Ghost {
  constructor({ name, step_s, pieces }, colour) {
    this.name = name;
    this.short = name.match(/\((.*)\)/)?.[1] ?? name;
    this.step_s = step_s;
    this.pieces = pieces;
    this.colour = colour;
    this.shown = true;
  }

  piece(t_s) {
    return this.pieces.findLast((piece) => piece.t_s <= t_s + 1e-6);
  }

  /** A state as telemetry has it, or null where there is no simulation. */
  at(t_s) {
    const piece = this.piece(t_s);
    const k = piece ? Math.floor((t_s - piece.t_s) / this.step_s + 1e-6) : -1;
    return piece && k < piece.x.length ? this.state(piece, k) : null;
  }

  state(piece, k) {
    const values = Object.fromEntries(FIELDS.map((name, i) => [name, piece.x[k][i]]));
    return { t_ns: (piece.t_s + k * this.step_s) * 1e9, run: "ghost", ...values, off_m: piece.off_m[k] };
  }

  /** The places of the pieces since from_s, each a line: [[[north, east], ...], ...]. */
  track(from_s, t_s) {
    const out = [];
    for (const piece of this.pieces) {
      if (piece.t_s > t_s || piece.t_s + piece.x.length * this.step_s < from_s) continue;
      const until = Math.floor((t_s - piece.t_s) / this.step_s + 1e-6) + 1;
      out.push(piece.x.slice(0, until).map(([north, east]) => [north, east]));
    }
    return out;
  }

  /** Everything into a history, for the plots; null at the end of a piece, so that no line leads to the next. */
  tell(history) {
    for (const piece of this.pieces) {
      piece.x.forEach((_, k) => history.push({ boat: this.name, topic: "state", sample: this.state(piece, k) }));
      const end_ns = (piece.t_s + (piece.x.length - 0.5) * this.step_s) * 1e9;
      history.push({ boat: this.name, topic: "state", sample: { t_ns: end_ns, run: "ghost", ...NOWHERE, off_m: null } });
    }
  }
}
