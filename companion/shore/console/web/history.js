// What boats told, by boat and topic, sorted by time. Pure: no DOM, no clock. Samples come in any order, some twice.

const ALERTS_KEPT = 300;
const TRACK_STEP_M = 0.05; // between kept places of a track: half a percent of what a map of 10 m shows
const TRACK_KEPT = 6000;

/** Index of the first item of a list sorted by `time` that is later than t. */
function after(list, t, time) {
  let low = 0;
  let high = list.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (time(list[middle]) <= t) low = middle + 1;
    else high = middle;
  }
  return low;
}

const nanoseconds = (sample) => sample.t_ns;
const first = (point) => point[0];

class Boat {
  constructor(keep_s) {
    this.run = null;
    this.keep_s = keep_s;
    this.begin(null);
  }

  begin(run) {
    this.run = run;
    this.topics = new Map();
    this.places = []; // [t_s, north_m, east_m]
    this.newest_ns = 0;
  }

  push(topic, sample) {
    if (this.run !== sample.run) this.begin(sample.run);
    let list = this.topics.get(topic);
    if (!list) this.topics.set(topic, (list = []));
    const place = list.length && list.at(-1).t_ns < sample.t_ns ? list.length : after(list, sample.t_ns, nanoseconds);
    for (let k = place - 1; k >= 0 && list[k].t_ns === sample.t_ns; k--)
      if (list[k].text === sample.text) return false; // the same again; only alerts have a text
    list.splice(place, 0, sample);
    this.newest_ns = Math.max(this.newest_ns, sample.t_ns);
    if (topic === "state") this.been(sample);
    this.trim(topic, list);
    return true;
  }

  been({ t_ns, north_m, east_m, health }) {
    if (health === "initialising") return; // it does not know yet where it is
    const t_s = t_ns * 1e-9;
    const place = after(this.places, t_s, first);
    const near = this.places[place - 1];
    if (near && Math.hypot(near[1] - north_m, near[2] - east_m) < TRACK_STEP_M) return;
    this.places.splice(place, 0, [t_s, north_m, east_m]);
    if (this.keep_s !== Infinity && this.places.length > TRACK_KEPT) this.places.splice(0, TRACK_KEPT / 10);
  }

  // What is told once or seldom is never forgotten: only the lists that grow are cut, and seldom at that.
  trim(topic, list) {
    if (topic === "alert") {
      if (this.keep_s !== Infinity && list.length > ALERTS_KEPT) list.splice(0, list.length - ALERTS_KEPT);
      return;
    }
    if (this.keep_s === Infinity || list.length < 3) return;
    const oldest = list.at(-1).t_ns - this.keep_s * 1e9;
    if (list[0].t_ns < oldest - this.keep_s * 2e8) list.splice(0, Math.max(after(list, oldest, nanoseconds) - 1, 0));
  }
}

export class History {
  /** keep_s: how much of the topics with a rate is kept, Infinity for a log. */
  constructor({ keep_s = 120 } = {}) {
    this.keep_s = keep_s;
    this.known = new Map();
  }

  /** Note one {boat, topic, sample}; whether it was new. A new `run` of a boat forgets what the old one told. */
  push({ boat, topic, sample }) {
    let known = this.known.get(boat);
    if (!known) this.known.set(boat, (known = new Boat(this.keep_s)));
    return known.push(topic, sample);
  }

  /** From now on keep so much of one boat. */
  keep(boat, keep_s) {
    const known = this.known.get(boat);
    if (known) known.keep_s = keep_s;
  }

  /** Names, sorted. */
  boats() {
    return [...this.known.keys()].sort((a, b) => a.localeCompare(b, undefined, { numeric: true }));
  }

  /** Samples of a topic, sorted by time. Not to be modified. */
  list(boat, topic) {
    return this.known.get(boat)?.topics.get(topic) ?? [];
  }

  /** Time of the newest sample of any topic [s], or null. */
  newest(boat) {
    const known = this.known.get(boat);
    return known?.newest_ns ? known.newest_ns * 1e-9 : null;
  }

  /** First and last time of the states [s], or null. */
  span(boat) {
    const list = this.list(boat, "state");
    return list.length ? [list[0].t_ns * 1e-9, list.at(-1).t_ns * 1e-9] : null;
  }

  /** The newest sample of a topic at t_s, or undefined. */
  last(boat, topic, t_s = Infinity) {
    const list = this.list(boat, topic);
    return t_s === Infinity ? list.at(-1) : list[after(list, t_s * 1e9, nanoseconds) - 1];
  }

  /** Everything as it was known at t_s: {t_s, topic: sample, ...}. */
  at(boat, t_s = Infinity) {
    const view = { t_s };
    for (const topic of this.known.get(boat)?.topics.keys() ?? [])
      if (topic !== "alert") view[topic] = this.last(boat, topic, t_s);
    return view;
  }

  /** Where the boat has been: [[north_m, east_m], ...]. */
  track(boat, from_s = -Infinity, to_s = Infinity) {
    const places = this.known.get(boat)?.places ?? [];
    return places.slice(after(places, from_s, first), after(places, to_s, first)).map(([, n, e]) => [n, e]);
  }
}
