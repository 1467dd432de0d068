// Compass and artificial horizon: how the boat lies on the water, as instruments and in words.

import { make } from "./panels.js";
import { compass, heard, placed } from "./shapes.js";
import { figure, heading } from "./words.js";

const SVG = "http://www.w3.org/2000/svg";
const DEGREES = 180 / Math.PI;
const PITCH_PX = 1.5; // a degree

function draw(parent, tag, attributes, text = "") {
  const element = parent.appendChild(document.createElementNS(SVG, tag));
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.textContent = text;
  return element;
}

function dial(parent, className) {
  const figure = parent.appendChild(make("figure"));
  const svg = draw(figure, "svg", { viewBox: "-50 -50 100 100", class: className, role: "img" });
  return [svg, figure.appendChild(make("figcaption"))];
}

export class Attitude {
  constructor(element) {
    [this.compass, this.course] = dial(element, "compass");
    draw(this.compass, "circle", { r: 46, class: "face" });
    for (let k = 0; k < 36; k++) draw(this.compass, "line", { y1: -46, y2: k % 9 ? -41 : -36, transform: `rotate(${k * 10})` });
    ["N", "E", "S", "W"].forEach((text, k) => draw(this.compass, "text", { x: [0, 29, 0, -29][k], y: [-24, 5, 33, 5][k] }, text));
    this.needle = draw(this.compass, "path", { d: "M0 -34 L9 16 L0 10 L-9 16 Z", class: "needle" });
    [this.horizon, this.tilt] = dial(element, "horizon");
    draw(this.horizon, "circle", { r: 46, class: "face" });
    this.water = draw(this.horizon, "path", { class: "water" });
    this.line = draw(this.horizon, "line", { class: "level" });
    draw(this.horizon, "path", { d: "M-26 0 H-9 M9 0 H26 M0 -3 V3", class: "boat-mark" });
  }

  /** state: the estimate, in site axes; attitude: the autopilot's. Null or undefined: not known. */
  show({ state, about, ...told }) {
    const attitude = heard(told.attitude, state);
    const psi_rad = compass(placed(state), about);
    this.say(this.compass, this.course, `Heading ${heading(psi_rad)} true`, `autopilot ${heading(attitude?.heading_rad)}`);
    this.needle.setAttribute("visibility", placed(state) ? "visible" : "hidden");
    if (placed(state)) this.needle.setAttribute("transform", `rotate(${(psi_rad * DEGREES).toFixed(1)})`);
    const [roll, pitch] = [attitude?.roll_rad * DEGREES, attitude?.pitch_rad * DEGREES];
    this.say(this.horizon, this.tilt, `Roll ${figure(roll, 1)}°`, `pitch ${figure(pitch, 1)}°`);
    for (const part of [this.water, this.line]) part.setAttribute("visibility", attitude ? "visible" : "hidden");
    this.tip(roll || 0, pitch || 0);
  }

  /** Water below the horizon: a segment of the dial, turned against the roll, lower where the bow is up. */
  tip(roll, pitch) {
    const y = Math.max(-44, Math.min(44, pitch * PITCH_PX));
    const x = Math.sqrt(46 ** 2 - y ** 2);
    const turn = `rotate(${(-roll).toFixed(1)})`;
    this.water.setAttribute("d", `M${-x} ${y} A46 46 0 ${y < 0 ? 1 : 0} 0 ${x} ${y} Z`);
    for (const [name, value] of Object.entries({ x1: -x, x2: x, y1: y, y2: y })) this.line.setAttribute(name, value);
    for (const part of [this.water, this.line]) part.setAttribute("transform", turn);
  }

  say(svg, caption, ...texts) {
    const words = texts.join(", ");
    if (svg.getAttribute("aria-label") === words) return;
    svg.setAttribute("aria-label", words);
    caption.replaceChildren(...texts.map((text) => make("span", "", text)));
  }
}
