// What a person wants to see, and in which units: kept by the browser for the next visit. Orders and files stay in SI.

import { make } from "./panels.js";
import { FURTHER, PANELS } from "./plots.js";

const KEY = "aritra-preferences";
export const ALL = [...PANELS, ...FURTHER];
const SPEEDS = { "m/s": { factor: 1, unit: "m/s", digits: 2 }, kn: { factor: 3600 / 1852, unit: "kn", digits: 2 } };
const RATES = { deg: { factor: 1, unit: "°/s", digits: 1 }, rad: { factor: Math.PI / 180, unit: "rad/s", digits: 3 } };
export const UNITS = { "m/s deg": ["m/s", "deg"], "kn deg": ["kn", "deg"], "m/s rad": ["m/s", "rad"], "kn rad": ["kn", "rad"] };

function kept() {
  try {
    return JSON.parse(localStorage.getItem(KEY)) ?? {};
  } catch {
    return {}; // a browser that keeps nothing, or something else
  }
}

export class Preferences {
  /** plots: Plots of all panels; choice: element for one checkbox a plot; units: <select>; changed(): draw anew. */
  constructor({ plots, choice, units, changed }) {
    this.plots = plots;
    const { shown, inUnits } = kept();
    const ids = (panels) => panels.map(({ id }) => id);
    this.shown = new Set(Array.isArray(shown) ? shown.filter((id) => ids(ALL).includes(id)) : ids(PANELS));
    units.value = UNITS[inUnits] ? inUnits : "m/s deg";
    units.addEventListener("change", () => {
      this.use(units.value);
      this.keep();
      changed();
    });
    choice.append(...ALL.map((spec) => this.checkbox(spec)));
    this.use(units.value);
    plots.show(this.shown);
  }

  checkbox({ id, title }) {
    const label = make("label");
    const box = Object.assign(document.createElement("input"), { type: "checkbox", checked: this.shown.has(id) });
    box.addEventListener("change", () => {
      if (box.checked) this.shown.add(id);
      else this.shown.delete(id);
      this.plots.show(this.shown);
      this.keep();
    });
    label.append(box, ` ${title}`);
    return label;
  }

  /** Another of `UNITS`. */
  use(inUnits) {
    this.inUnits = inUnits;
    const [speed, rate] = UNITS[inUnits];
    this.units = { speed: SPEEDS[speed], rate: RATES[rate] };
    this.plots.setUnits(this.units);
  }

  keep() {
    try {
      localStorage.setItem(KEY, JSON.stringify({ shown: [...this.shown], inUnits: this.inUnits }));
    } catch {
      // as long as the page is open
    }
  }
}
