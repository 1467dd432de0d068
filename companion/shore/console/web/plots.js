// Plots against time, drawn by uPlot: one panel a figure, one cursor for all, gaps where there are no samples.

import { BATTERY_OLD_S } from "./panels.js";
import { ink, onTheme } from "./theme.js";
import { figure } from "./words.js";

const uPlot = globalThis.uPlot;
const INKS = ["plot-1", "plot-2", "plot-3", "plot-4", "plot-5", "plot-6"]; // of theme.css
const DASHES = [[], [7, 4], [2, 3], [10, 3, 2, 3], [4, 4], [1, 4]];
const GAP_S = 2.5; // longer silence is drawn as silence; topics come at least once a second
const DEGREES = 180 / Math.PI;
const axis = () => ({ stroke: ink("ink"), grid: { stroke: ink("plot-grid"), width: 1 }, ticks: { stroke: ink("plot-tick"), width: 1, size: 4 }, font: "12px system-ui, sans-serif" });

const one = (label, topic, value) => ({ label, topic, value });

function pulses(about) {
  return (about?.thrusters ?? []).map((thruster, k) => one(thruster.name, "thrusters", (s) => s.pwm_us[k]));
}

function forces(about) {
  return (about?.thrusters ?? []).map((thruster, k) => one(thruster.name, "thrusters", (s) => s.force_n[k]));
}

/** From true north, as the page's other headings. */
function headings(about) {
  const true_deg = (psi_rad) => psi_rad * DEGREES + (about?.rotation_deg ?? 0);
  return [one("heading", "state", (s) => true_deg(s.psi_rad)), one("asked", "reference", (s) => true_deg(s.psi_ref_rad))];
}

/** lines(about): what a panel draws; the first line of a panel is the measured one. min_span: least height of its axis;
    quantity: of `setUnits`, where there is a choice. */
export const PANELS = [
  { id: "u", title: "Surge u", quantity: "speed", unit: "m/s", digits: 2, min_span: 0.2, lines: () => [one("u", "state", (s) => s.u_m_s), one("asked", "reference", (s) => s.u_ref_m_s)] },
  { id: "v", title: "Sway v", quantity: "speed", unit: "m/s", digits: 2, min_span: 0.2, lines: () => [one("v", "state", (s) => s.v_m_s)] },
  { id: "r", title: "Yaw rate r", quantity: "rate", unit: "°/s", digits: 1, min_span: 4, lines: () => [one("r", "state", (s) => s.r_rad_s * DEGREES)] },
  { id: "y_e", title: "Cross-track", unit: "m", digits: 2, min_span: 0.4, lines: () => [one("y_e", "reference", (s) => s.y_e_m)] },
  { id: "pwm", title: "Pulse width", unit: "µs", digits: 0, min_span: 40, lines: pulses },
  { id: "voltage", title: "Battery", unit: "V", digits: 1, min_span: 1, lines: () => [one("voltage", "battery", (s) => (s.age_s > BATTERY_OLD_S ? null : s.voltage_v))] },
  { id: "solve", title: "Solve time", unit: "ms", digits: 1, min_span: 5, lines: () => [one("median", "timing", (s) => s.solve.median_ms), one("largest", "timing", (s) => s.solve.max_ms)] },
  { id: "late", title: "Loop lateness", unit: "ms", digits: 1, min_span: 2, lines: () => [one("median", "timing", (s) => s.lateness.median_ms), one("largest", "timing", (s) => s.lateness.max_ms)] },
];

/** Those that are drawn when somebody asks for them. */
export const FURTHER = [
  { id: "psi", title: "Heading", unit: "°", digits: 0, min_span: 20, lines: headings },
  { id: "tilt", title: "Roll and pitch", unit: "°", digits: 1, min_span: 4, lines: () => [one("roll", "attitude", (s) => s.roll_rad * DEGREES), one("pitch", "attitude", (s) => s.pitch_rad * DEGREES)] },
  { id: "place", title: "Place", unit: "m", digits: 2, min_span: 1, lines: () => [one("north", "state", (s) => s.north_m), one("east", "state", (s) => s.east_m)] },
  { id: "force", title: "Force", unit: "N", digits: 1, min_span: 2, lines: forces },
];

/** Times and values of one line between two instants; null where samples are missing for long. */
function column(list, value, from_s, to_s, zero_s) {
  const t = [];
  const y = [];
  for (const sample of list) {
    const at = sample.t_ns * 1e-9;
    if (at < from_s - GAP_S || at > to_s) continue;
    const x = at - zero_s;
    if (t.length && x - t.at(-1) > GAP_S) {
      t.push(t.at(-1) + 1e-3);
      y.push(null);
    }
    t.push(x);
    y.push(value(sample) ?? null);
  }
  return [t, y];
}

const colour = ({ k, ghost, source }) => ink(INKS[(k + (ghost ? source * 2 : 0)) % INKS.length]);

class Panel {
  constructor(parent, spec, owner) {
    this.spec = spec;
    this.owner = owner;
    this.root = parent.appendChild(document.createElement("figure"));
    this.root.className = "plot";
    const caption = this.root.appendChild(document.createElement("figcaption"));
    this.title = caption.appendChild(Object.assign(document.createElement("span"), { className: "title" }));
    this.setUnit({ factor: 1, unit: spec.unit, digits: spec.digits });
    this.legend = caption.appendChild(document.createElement("span"));
    this.legend.className = "legend";
    this.canvas = this.root.appendChild(document.createElement("div"));
    this.canvas.className = "canvas";
    this.canvas.setAttribute("role", "img");
    this.lines = "";
  }

  setUnit(unit) {
    this.unit = unit;
    this.title.textContent = `${this.spec.title} [${unit.unit}]`;
  }

  /** `sources`: [{history, boat, label, ghost}]; a new chart where the lines are others than before. */
  draw(sources, window) {
    const lines = sources.flatMap(({ history, boat, label, ghost }, source) =>
      this.spec.lines(history.last(boat, "about"))
        .map((line, k) => ({ ...line, history, boat, ghost, source, k, name: [label, line.label].filter(Boolean).join(" ") }))
        .filter((line) => !ghost || history.list(boat, line.topic).length)); // a ghost has but a few of the topics
    const key = JSON.stringify(lines.map((l) => [l.name, l.ghost]));
    if (key !== this.lines) this.make(lines, key);
    const { from_s, to_s, zero_s } = window;
    this.window = [from_s - zero_s, to_s - zero_s];
    const tables = lines.map((l) => column(l.history.list(l.boat, l.topic), (s) => scaled(l.value(s), this.unit.factor), from_s, to_s, zero_s));
    this.data = tables.length ? uPlot.join(tables, tables.map(() => [1, 1])) : [[]];
    this.plot?.setData(this.data, true);
    this.say();
  }

  make(lines, key) {
    this.lines = key;
    this.plot?.destroy();
    this.legend.replaceChildren();
    this.values = lines.map((line) => {
      const item = this.legend.appendChild(document.createElement("span"));
      const swatch = item.appendChild(document.createElement("i"));
      swatch.style.borderTop = `3px ${line.ghost || line.k ? "dashed" : "solid"} ${colour(line)}`;
      if (lines.length > 1) item.append(`${line.name} `);
      return item.appendChild(document.createElement("b"));
    });
    const series = lines.map((line) => ({
      label: line.name, width: line.ghost ? 1.5 : 2, points: { show: false },
      stroke: colour(line), dash: line.ghost ? [3, 3] : DASHES[line.k % DASHES.length],
    }));
    this.names = lines.map((l) => l.name);
    this.plot = new uPlot(this.options(series), [[], ...lines.map(() => [])], this.canvas);
  }

  options(series) {
    const { spec, owner } = this;
    return {
      ...this.size(), legend: { show: false }, series: [{}, ...series], padding: [8, 10, 0, 0],
      cursor: { sync: { key: owner.key, setSeries: false }, drag: { x: false, y: false }, points: { show: false }, y: false },
      scales: {
        x: { time: false, range: () => this.window ?? [0, 1] },
        y: { range: (_, low, high) => span(low, high, spec.min_span * this.unit.factor) },
      },
      axes: [
        { ...axis(), size: 26, space: 60, values: (_, ticks) => ticks.map((t) => figure(t, 0, "s")) },
        { ...axis(), size: 46, space: 26, values: (_, ticks) => ticks.map((t) => figure(t, digitsOf(ticks))) },
      ],
      hooks: { setCursor: [() => this.say()], draw: [(u) => owner.mark(u)] },
    };
  }

  /** The newest figures, or those at the cursor, in the caption and for screen readers. */
  say() {
    if (!this.plot || !this.data) return;
    const at = this.plot.cursor.idx;
    const told = this.data.slice(1).map((values) => {
      let k = at ?? values.length - 1;
      while (k > 0 && (values[k] === null || values[k] === undefined)) k--;
      return figure(values[k], this.unit.digits);
    });
    told.forEach((text, k) => {
      if (this.values[k].textContent !== text) this.values[k].textContent = text;
    });
    const words = told.map((text, k) => `${this.names[k]} ${text}`).join(", ");
    this.canvas.setAttribute("aria-label", `${this.spec.title}, ${this.unit.unit}: ${words || "no data"}`);
  }

  size() {
    return { width: Math.max(this.canvas.clientWidth, 120), height: Math.max(this.canvas.clientHeight, 90) };
  }
}

/** In another unit; a missing value stays one. */
const scaled = (value, factor) => (value === null || value === undefined ? null : value * factor);

/** Decimals that tell ticks apart exactly: 0.25 needs two. */
function digitsOf(ticks) {
  const step = ticks.length > 1 ? ticks[1] - ticks[0] : 1;
  return [0, 1, 2, 3].find((k) => Math.abs(step - Number(step.toFixed(k))) < 1e-3 * step) ?? 3;
}

/** Range of an axis: what is there, with some room, and never less than `least`. */
function span(low, high, least) {
  if (low === null || high === null) return [0, least];
  const room = Math.max((least - (high - low)) / 2, 0.08 * (high - low), 0);
  return [low - room, high + room];
}

let plots = 0;

export class Plots {
  /** axis: the page's words for the time axis are its own; zero_s of `draw` says where 0 is. */
  constructor(element, { panels = PANELS } = {}) {
    this.key = `aritra-${plots++}`;
    this.onseek = null;
    this.cursor_s = null;
    this.panels = panels.map((spec) => new Panel(element, spec, this));
    this.resize = new ResizeObserver(() => this.panels.forEach((p) => p.plot?.setSize(p.size())));
    this.resize.observe(element);
    onTheme(() => this.repaint());
    this.seek = (event) => {
      const panel = this.panels.find((p) => p.canvas.contains(event.target));
      if (!this.onseek || !panel?.plot || !(event.buttons & 1)) return;
      const box = panel.plot.over.getBoundingClientRect();
      const x = panel.plot.posToVal(event.clientX - box.left, "x");
      this.onseek(Math.max(panel.window[0], Math.min(panel.window[1], x)) + this.window.zero_s);
    };
    element.addEventListener("pointerdown", this.seek);
    element.addEventListener("pointermove", this.seek);
    this.element = element;
  }

  /** Draw the panels between two instants; the axis counts from zero_s. `sources`: [{history, boat, label, ghost}]. */
  draw(sources, window) {
    this.sources = sources;
    this.window = window;
    for (const panel of this.panels) if (!panel.root.hidden) panel.draw(sources, window);
  }

  /** Only the panels of these ids. */
  show(ids) {
    for (const panel of this.panels) panel.root.hidden = !ids.has(panel.spec.id);
    if (this.window) this.draw(this.sources, this.window);
  }

  /** quantity -> {factor, unit, digits}, for the panels of that quantity. */
  setUnits(units) {
    for (const panel of this.panels) if (units[panel.spec.quantity]) panel.setUnit(units[panel.spec.quantity]);
    if (this.window) this.draw(this.sources, this.window);
  }

  /** The same in the colours of now. */
  repaint() {
    for (const panel of this.panels) panel.lines = "";
    if (this.window) this.draw(this.sources, this.window);
  }

  /** A line at an instant on every panel; null: none. */
  cursor(t_s) {
    this.cursor_s = t_s;
    for (const panel of this.panels) panel.plot?.redraw(false);
  }

  mark(u) {
    if (this.cursor_s === null || !this.window) return;
    const x = Math.round(u.valToPos(this.cursor_s - this.window.zero_s, "x", true));
    const { ctx, bbox } = u;
    if (x < bbox.left || x > bbox.left + bbox.width) return;
    ctx.save();
    ctx.fillStyle = ink("ink");
    ctx.fillRect(x, bbox.top, 2, bbox.height);
    ctx.restore();
  }

  destroy() {
    this.resize.disconnect();
    for (const panel of this.panels) {
      panel.plot?.destroy();
      panel.root.remove();
    }
    this.element.removeEventListener("pointerdown", this.seek);
    this.element.removeEventListener("pointermove", this.seek);
  }
}
