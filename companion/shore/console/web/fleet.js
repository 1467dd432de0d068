// Which boats there are, which of them a STOP can reach, and why not. Pure: no DOM; what is known is asked for.

export const LOST_S = 5; // silent for so long, and its program out of reach

/** clocks: boat -> [its clock minus the console's, ms, null: not heard; whether its token is there; programs of its name; why no orders]. */
export class Fleet {
  constructor(history, clocks, age_s) {
    Object.assign(this, { history, clocks, age_s, away: new Map(), left: new Map() });
  }

  /** The console was started anew, with another clock maybe: boats that it has not heard go on by the page's clock, out of reach. */
  restart() {
    for (const boat of this.history.boats()) {
      this.left.set(boat, (this.history.newest(boat) + this.age_s(boat)) * 1000 - performance.now());
      this.clocks.set(boat, [this.clocks.get(boat)?.[0] ?? 0, false, 0, ""]);
    }
  }

  /** What a frame tells of clocks. `ahead_ms`: the console's clock minus the page's. */
  hear(told, ahead_ms) {
    for (const [boat, clock] of Object.entries(told)) {
      this.clocks.set(boat, clock);
      if (clock[0] !== null) this.left.delete(boat);
    }
    for (const [boat, left_ms] of this.left) this.clocks.get(boat)[0] = left_ms - ahead_ms;
  }

  /** Names of boats that were not put away; one that speaks again is there again. */
  names() {
    for (const [boat, newest] of this.away) if (this.history.newest(boat) !== newest || this.there(boat)) this.away.delete(boat);
    return this.history.boats().filter((boat) => !this.away.has(boat));
  }

  /** Whether its program can be reached: its token is there. */
  there(boat) {
    return Boolean(this.clocks.get(boat)?.[1]);
  }

  /** Whether its program has ended: it said so, and its token is gone. Words alone, which are not signed, stop no STOP. */
  ended(boat) {
    return Boolean(this.history.last(boat, "mode")?.ended) && !this.there(boat);
  }

  /** Whether nothing is heard of it, and its program cannot be reached; it may drive on. */
  lost(boat) {
    return !this.there(boat) && !this.ended(boat) && !(this.age_s(boat) <= LOST_S);
  }

  putAway(boat) {
    this.away.set(boat, this.history.newest(boat));
  }

  /** Why a STOP cannot be sent to a boat, [in short, and what to do]; null: it can. `commands`: the console has a key. */
  noStop(boat, commands) {
    if (!boat) return ["no boat", ""];
    if (!commands) return ["no command key", "This console has no command key: it only looks. Start `aritra shore` with --command-key to give orders."];
    const problem = this.clocks.get(boat)?.[3];
    if (problem) return [`no key for ${boat}`, `STOP cannot be sent to ${boat}: ${problem}`];
    if (this.ended(boat)) return [`${boat} has ended`, `${boat} has ended, as its program said: no order reaches it.`];
    return null;
  }

  /** What may keep a STOP that is sent from working; empty: nothing that is known. */
  doubt(boat) {
    if (this.history.last(boat, "about")?.commands === false) return `${boat} takes no orders from shore (telemetry.commands in its run file): STOP will hardly work.`;
    if (this.lost(boat)) return `${boat} cannot be reached: STOP would be tried for 10 s, and may not arrive.`;
    return "";
  }

  /** Boats that a STOP can be sent to. */
  stoppable(commands) {
    return this.names().filter((boat) => !this.noStop(boat, commands));
  }
}
