// The drawn mission's waypoints as rows of fields, which do what the map does, by keyboard.

import { make } from "../panels.js";
import { figure } from "../words.js";
import { legs } from "./checks.js";

const FIELDS = [
  ["north_m", "North", "m"],
  ["east_m", "East", "m"],
  ["speed_m_s", "Speed", "m/s"],
  ["acceptance_m", "Radius", "m"],
];
const NEEDED = ["north_m", "east_m"]; // the others may be left to the boat

export class MissionList {
  /** change(k, parts), remove(k): what its fields and buttons do. */
  constructor(element, { change, remove }) {
    Object.assign(this, { element, change, remove });
  }

  /** wrong: numbers of waypoints that are wrong. Elements stay, and with them the focus. */
  show(waypoints, wrong) {
    const lengths = legs(waypoints);
    while (this.element.children.length > waypoints.length) this.element.lastChild.remove();
    waypoints.forEach((w, k) => {
      const row = this.element.children[k] ?? this.add(k);
      row.classList.toggle("wrong", wrong.has(k));
      for (const input of row.querySelectorAll("input")) {
        const text = w[input.name] === null ? "" : String(w[input.name]);
        if (input.value !== text && (document.activeElement !== input || !input.dirty)) input.value = text;
      }
      row.querySelector(".leg").textContent = lengths[k] === null ? "start" : figure(lengths[k], 1, "m");
    });
  }

  add(k) {
    const row = this.element.appendChild(make("li"));
    row.append(make("b", "", String(k + 1)));
    for (const [name, title, unit] of FIELDS) row.append(this.field(k, name, title, unit));
    const remove = make("button", "remove", "×");
    remove.title = `Delete waypoint ${k + 1}`;
    remove.setAttribute("aria-label", remove.title);
    remove.addEventListener("click", () => {
      this.remove(k);
      (this.element.children[Math.min(k, this.element.children.length - 1)]?.querySelector(".remove") ?? this.element).focus();
    });
    row.append(make("span", "leg"), remove);
    return row;
  }

  field(k, name, title, unit) {
    const label = make("label");
    const input = Object.assign(document.createElement("input"), { name, type: "number", step: "any", inputMode: "decimal" });
    input.setAttribute("aria-label", `Waypoint ${k + 1}: ${title.toLowerCase()} in ${unit}`);
    if (!NEEDED.includes(name)) input.placeholder = "default";
    input.addEventListener("input", () => (input.dirty = true));
    input.addEventListener("change", () => {
      input.dirty = false;
      if (input.value === "" && NEEDED.includes(name)) return this.change(k, {}); // as it was
      this.change(k, { [name]: input.value === "" ? null : Number(input.value) });
    });
    label.append(make("span", "", `${title} [${unit}]`), input);
    return label;
  }
}
