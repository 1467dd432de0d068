// A log as the live console would have shown it, at any time of it: the same map, plots and panels, and ghosts beside.

import { Ghost } from "./ghost.js";
import { History } from "./history.js";
import { BoatMap } from "./map.js";
import { make, showAlerts, showFigures, showLinks, showMode, showThrusters } from "./panels.js";
import { PANELS, Plots } from "./plots.js";
import { clock, clockOptions } from "./words.js";

const SPEEDS = [0.5, 1, 2, 5, 10, 30, 100];
const WINDOWS = [["all of the log", Infinity], ["5 min", 300], ["1 min", 60], ["20 s", 20]];
const FRAME_MS = 66;
const TRACK_S = 600; // behind the boat; longer lines are slow to draw
const GHOST_TRACK_S = 60;
const GHOST_COLOURS = ["var(--plot-3)", "var(--plot-5)"]; // those that the plots give to the second and third source
const BOAT_COLOUR = "var(--boat)";
const OFF = { id: "off", title: "Distance from simulation", unit: "m", digits: 2, min_span: 0.2,
  lines: (about) => (about ? [] : [{ label: "distance", topic: "state", value: (s) => s.off_m }]) };

// As in the page's head: it may be read anywhere.
Object.assign(clockOptions, { timeZone: "UTC", timeZoneName: "short", hour: "2-digit", minute: "2-digit", second: "2-digit" });

const $ = (id) => document.getElementById(id);

async function unpack(element) {
  const bytes = Uint8Array.from(atob(element.textContent.trim()), (c) => c.charCodeAt(0));
  element.remove();
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return JSON.parse(await new Response(stream).text());
}

class Page {
  constructor(data) {
    this.boat = data.boat;
    this.unix_minus_t_ns = data.unix_minus_t_ns;
    this.history = new History({ keep_s: Infinity });
    for (const [topic, sample] of data.samples) this.history.push({ boat: this.boat, topic, sample });
    this.ghosts = data.ghosts.map((ghost, k) => new Ghost(ghost, GHOST_COLOURS[k % GHOST_COLOURS.length]));
    for (const ghost of this.ghosts) ghost.tell(this.history);
    this.zero_s = data.zero_s;
    this.length_s = data.length_s;
    this.t_s = 0; // since the start of the log
    this.speed = 1;
    this.playing = false;
    this.window_s = Infinity;
    this.drawn = null;
    this.map = new BoatMap($("map"), { label: "Map of the log" });
    this.plots = new Plots($("plots"), { panels: this.ghosts.length ? [...PANELS.slice(0, 4), OFF, ...PANELS.slice(4)] : PANELS });
    this.plots.onseek = (t_s) => this.seek(t_s - this.zero_s);
    this.words(data);
    this.controls();
    this.seek(data.start_s);
    this.map.fit(this.history.at(this.boat));
  }

  words({ title, about, ghosts, errors }) {
    $("name").textContent = title;
    $("about").textContent = about;
    if (!ghosts.length) return;
    $("error-box").hidden = false;
    $("error-how").textContent = errors.how;
    const head = $("errors").createTHead().insertRow();
    for (const name of ["after", "model", ...errors.channels]) head.append(Object.assign(make("th", "", name), { scope: "col" }));
    const body = $("errors").createTBody();
    for (const row of errors.rows) {
      const line = body.insertRow();
      row.forEach((text) => (line.insertCell().textContent = text));
    }
  }

  controls() {
    $("slider").max = this.length_s.toFixed(1);
    $("slider").addEventListener("input", () => this.seek(Number($("slider").value)));
    $("play").addEventListener("click", () => this.play(!this.playing));
    $("follow").addEventListener("click", () => this.map.setFollow(!this.map.follow));
    this.map.onfollow = (follow) => $("follow").setAttribute("aria-pressed", String(follow));
    $("fit").addEventListener("click", () => this.map.fit(this.history.at(this.boat)));
    $("near").addEventListener("click", () => this.map.near(this.history.at(this.boat, this.zero_s + this.t_s)));
    for (const speed of SPEEDS) $("speed").add(new Option(`${speed} ×`, speed, false, speed === 1));
    $("speed").addEventListener("change", () => (this.speed = Number($("speed").value)));
    WINDOWS.forEach(([name, seconds], k) => $("window").add(new Option(name, k, false, seconds === Infinity)));
    $("window").addEventListener("change", () => {
      this.window_s = WINDOWS[Number($("window").value)][1];
      this.seek(this.t_s);
    });
    $("ghosts").hidden = !this.ghosts.length;
    for (const ghost of this.ghosts) {
      const label = make("label");
      const box = Object.assign(document.createElement("input"), { type: "checkbox", checked: true });
      box.addEventListener("change", () => this.show(ghost, box.checked));
      const swatch = make("i");
      swatch.style.borderTopColor = ghost.colour;
      label.append(box, swatch, ghost.name);
      $("ghosts").append(label);
      ghost.box = box;
    }
    document.addEventListener("keydown", (event) => this.key(event));
  }

  key(event) {
    const own = event.target.closest("select, summary, button, #map, .alerts, input[type=checkbox]");
    if (event.ctrlKey || event.metaKey || event.altKey || (own && event.key !== "g" && event.key !== "f")) return;
    const step = event.shiftKey ? 10 : 1;
    const faster = SPEEDS.indexOf(this.speed);
    const act = {
      " ": () => this.play(!this.playing),
      ArrowLeft: () => this.seek(this.t_s - step),
      ArrowRight: () => this.seek(this.t_s + step),
      Home: () => this.seek(0),
      End: () => this.seek(this.length_s),
      "[": () => this.setSpeed(SPEEDS[Math.max(faster - 1, 0)]),
      "]": () => this.setSpeed(SPEEDS[Math.min(faster + 1, SPEEDS.length - 1)]),
      g: () => this.ghosts.forEach((ghost) => this.show(ghost, !ghost.shown)),
      f: () => this.map.fit(this.history.at(this.boat)),
    }[event.key];
    if (!act) return;
    event.preventDefault();
    act();
  }

  setSpeed(speed) {
    this.speed = speed;
    $("speed").value = String(speed);
  }

  show(ghost, shown) {
    ghost.shown = ghost.box.checked = shown;
    this.drawn = null;
    this.draw();
  }

  play(playing) {
    if (playing && this.t_s >= this.length_s) this.t_s = 0;
    this.playing = playing;
    $("play").textContent = playing ? "Pause" : "Play";
    $("play").setAttribute("aria-pressed", String(playing));
    if (playing) this.tick(performance.now());
  }

  tick(before_ms) {
    setTimeout(() => {
      if (!this.playing) return;
      const now_ms = performance.now();
      this.seek(this.t_s + ((now_ms - before_ms) / 1000) * this.speed);
      if (this.t_s >= this.length_s) this.play(false);
      else this.tick(now_ms);
    }, FRAME_MS);
  }

  seek(t_s) {
    this.t_s = Math.min(Math.max(t_s, 0), this.length_s);
    this.draw();
  }

  draw() {
    const at_s = this.zero_s + this.t_s;
    const view = this.history.at(this.boat, at_s);
    const about = (view.about ??= this.history.last(this.boat, "about"));
    view.path ??= this.history.list(this.boat, "path")[0];
    $("slider").value = this.t_s.toFixed(1);
    const time = clock(at_s * 1e9, this.unix_minus_t_ns);
    $("clock").textContent = `${this.t_s.toFixed(1)} of ${this.length_s.toFixed(0)} s, ${time}`;
    $("slider").setAttribute("aria-valuetext", `${this.t_s.toFixed(1)} seconds`);
    if (view.state) this.map.show(this.boat, view, { track: this.history.track(this.boat, at_s - TRACK_S, at_s), colour: BOAT_COLOUR, chosen: true });
    for (const ghost of this.ghosts) this.drawGhost(ghost, about, at_s);
    showMode($("mode"), view);
    showFigures($("figures"), view);
    showThrusters($("thrusters"), view);
    showAlerts($("alerts"), this.history.list(this.boat, "alert"), at_s, this.unix_minus_t_ns);
    showLinks($("links"), view.links, view.timing);
    this.drawPlots(at_s);
  }

  drawGhost(ghost, about, at_s) {
    const state = ghost.shown ? ghost.at(at_s) : null;
    if (!state) return this.map.forget(ghost.name);
    this.map.show(ghost.name, { state, about }, { track: ghost.track(at_s - GHOST_TRACK_S, at_s), colour: ghost.colour, ghost: true });
  }

  drawPlots(at_s) {
    let [from_s, to_s] = [this.zero_s, this.zero_s + this.length_s];
    if (this.window_s < this.length_s) {
      from_s = Math.min(Math.max(at_s - this.window_s / 2, from_s), to_s - this.window_s);
      to_s = from_s + this.window_s;
    }
    const key = `${from_s.toFixed(1)}`;
    if (this.drawn !== key + this.window_s) {
      this.drawn = key + this.window_s;
      const ghosts = this.ghosts.filter((g) => g.shown).map((g) => ({ history: this.history, boat: g.name, label: g.short, ghost: true }));
      this.plots.draw([{ history: this.history, boat: this.boat, label: "", ghost: false }, ...ghosts], { from_s, to_s, zero_s: this.zero_s });
    }
    this.plots.cursor(at_s);
    for (const { plot } of this.plots.panels) plot?.setCursor({ left: plot.valToPos(this.t_s, "x"), top: 0 }, true, false);
  }
}

unpack($("data")).then((data) => {
  globalThis.page = new Page(data);
  document.body.dataset.ready = "true";
});
