// A mission while it is drawn: waypoints in site axes, every step can be undone; and its file, in TOML as the boat's
// loader reads it (docs/run-file.md). Pure: no DOM.

const STEPS = 200; // that can be undone
const MM = 1000;
const MAX_NAME = 60;

/** To the millimetre, and to 0.1 mm/s: what is shown, checked and written is one number. */
const round = (value, per = MM) => (value === null ? null : Math.round(value * per) / per);

/** A waypoint as it is kept: {north_m, east_m, speed_m_s, acceptance_m}; speed and radius null: the boat's default. */
export function waypoint({ north_m, east_m, speed_m_s = null, acceptance_m = null }) {
  return { north_m: round(north_m), east_m: round(east_m), speed_m_s: round(speed_m_s, 1e4), acceptance_m: round(acceptance_m) };
}

const EMPTY = { name: "drawn", end_heading_deg: null, waypoints: [], fences: [] };

export class Plan {
  constructor() {
    this.now = EMPTY;
    this.past = [];
    this.future = [];
  }

  get waypoints() {
    return this.now.waypoints;
  }

  /** One step: `change` are the parts of it that are other than before. */
  set(change) {
    this.past.push(this.now);
    if (this.past.length > STEPS) this.past.shift();
    this.future = [];
    this.now = { ...this.now, ...change };
  }

  undo() {
    if (!this.past.length) return;
    this.future.push(this.now);
    this.now = this.past.pop();
  }

  redo() {
    if (!this.future.length) return;
    this.past.push(this.now);
    this.now = this.future.pop();
  }

  /** A waypoint before the k-th, at the end without k: as fast and as wide as the one before it. */
  add([north_m, east_m], k = this.waypoints.length) {
    const { speed_m_s = null, acceptance_m = null } = this.waypoints[Math.max(k - 1, 0)] ?? {};
    this.set({ waypoints: this.waypoints.toSpliced(k, 0, waypoint({ north_m, east_m, speed_m_s, acceptance_m })) });
  }

  change(k, parts) {
    this.set({ waypoints: this.waypoints.with(k, waypoint({ ...this.waypoints[k], ...parts })) });
  }

  remove(k) {
    this.set({ waypoints: this.waypoints.toSpliced(k, 1) });
  }

  clear() {
    this.set(EMPTY);
  }

  /** Another mission, as the console read it from a file, or as the boat reports it. */
  take({ name, end_heading_deg = null, waypoints, fences = [] }) {
    this.set({ name: cleanName(name), end_heading_deg, waypoints: waypoints.map(waypoint), fences });
  }
}

/** A name without control characters and halves of characters: a file must be able to hold it. */
export function cleanName(name) {
  return [...name.replace(/\p{C}/gu, " ")].slice(0, MAX_NAME).join("").trim() || EMPTY.name;
}

/** Name of its file. */
export function fileName({ name }) {
  return `${name.replace(/[^A-Za-z0-9_-]+/g, "-").replace(/^-+|-+$/g, "").slice(0, MAX_NAME) || EMPTY.name}.toml`;
}

const number = (value) => (Number.isInteger(value) ? value.toFixed(1) : String(value));

/** The mission's file. `site`: whose axes its metres are in. */
export function toToml({ name, end_heading_deg, waypoints, fences }, site = "") {
  const lines = [`# Drawn in the console. Metres in the axes of the site${site ? ` ${JSON.stringify(cleanName(site))}` : ""}.`, `name = ${JSON.stringify(cleanName(name))}`];
  if (end_heading_deg !== null) lines.push(`end_heading_deg = ${number(round(end_heading_deg))}`);
  for (const each of waypoints) {
    lines.push("", "[[waypoints]]");
    for (const [key, value] of Object.entries(each)) if (value !== null) lines.push(`${key} = ${number(value)}`);
  }
  for (const { inclusion, polygon } of fences) {
    lines.push("", "[[fences]]", `inclusion = ${inclusion}`, `polygon = [${polygon.map((place) => `[${place.map(number).join(", ")}]`).join(", ")}]`);
  }
  return `${lines.join("\n")}\n`;
}
