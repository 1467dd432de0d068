// Grid with metres written at its lines, scale bar and north arrow, for a Leaflet map in metres.

import { roundStep } from "./shapes.js";
import { heading } from "./words.js";

const L = globalThis.L;
const LEAST_PX = 70; // between two grid lines
const BAR_PX = 90;
const DEGREES = 180 / Math.PI;

function text(className, content) {
  const element = document.createElement("div");
  element.className = className;
  element.textContent = content;
  return element;
}

export class Grid {
  constructor(map) {
    this.map = map;
    this.lines = L.layerGroup().addTo(map);
    this.labels = map.getContainer().appendChild(text("grid-labels", ""));
    this.labels.setAttribute("aria-hidden", "true");
    this.scale = map.getContainer().appendChild(text("scale-bar", ""));
    this.north = map.getContainer().appendChild(text("north-arrow", "N"));
    this.north.setAttribute("role", "img");
    this.turn(0);
    map.on("moveend zoomend resize viewreset", () => this.draw());
    this.draw();
  }

  /** The arrow to true north: up is the first axis of a site, which lies so much clockwise of it. */
  turn(rotation_deg) {
    this.north.style.rotate = `${-rotation_deg}deg`;
    this.north.setAttribute("aria-label", rotation_deg ? `Up is ${heading(rotation_deg / DEGREES)} true` : "North is up");
  }

  draw() {
    const perMetre = 2 ** this.map.getZoom();
    const step = roundStep(LEAST_PX / perMetre);
    const bounds = this.map.getBounds();
    const [south, west, north, east] = [bounds.getSouth(), bounds.getWest(), bounds.getNorth(), bounds.getEast()];
    this.lines.clearLayers();
    this.labels.replaceChildren();
    const digits = step < 1 ? Math.ceil(-Math.log10(step)) : 0;
    const put = (places, zero) => L.polyline(places, { color: "var(--grid)", weight: zero ? 1.6 : 0.7, interactive: false }).addTo(this.lines);
    const margin = step;
    for (let k = Math.ceil(south / step); k * step <= north; k++) {
      put([[k * step, west - margin], [k * step, east + margin]], k === 0);
      const at = this.map.latLngToContainerPoint([k * step, west]);
      this.label(`${(k * step).toFixed(digits)}`, "north", 4, at.y);
    }
    for (let k = Math.ceil(west / step); k * step <= east; k++) {
      put([[south - margin, k * step], [north + margin, k * step]], k === 0);
      const at = this.map.latLngToContainerPoint([south, k * step]);
      this.label(`${(k * step).toFixed(digits)}`, "east", at.x, null);
    }
    this.lines.eachLayer((layer) => layer.bringToBack());
    const bar = roundStep(BAR_PX / perMetre);
    this.scale.style.width = `${bar * perMetre}px`;
    this.scale.textContent = bar >= 1000 ? `${bar / 1000} km` : bar >= 1 ? `${bar} m` : `${Math.round(bar * 100)} cm`;
  }

  label(content, side, x, y) {
    const size = this.map.getSize();
    if (side === "north" && (y < 64 || y > size.y - 34)) return;
    if (side === "east" && (x < 34 || x > size.x - 90)) return;
    const element = this.labels.appendChild(text(`grid-label ${side}`, `${content} m ${side === "north" ? "N" : "E"}`));
    element.style.left = `${x}px`;
    if (y !== null) element.style.top = `${y}px`;
  }
}
