// The map: metres, north up, to scale. Leaflet draws, pans and zooms (mouse, touch, arrow keys, + and -).
// Places are [north_m, east_m], which Leaflet's plane (CRS.Simple) takes as [y, x].

import { Grid } from "./grid.js";
import { arrow, ellipse, fresh, guided, heard, outline, placed, sizeOf, toMap } from "./shapes.js";

const L = globalThis.L;
const INK = "var(--ink)"; // colours are those of theme.css
const GREY = "var(--old-boat)";
const COLOURS = { path: "var(--path)", horizon: "var(--horizon)", fence: "var(--fence)" };
const FADED = 0.4; // of a boat that has ended
const SMALL_PX = 16; // a boat that is smaller on the screen gets a ring around it, so that it can be seen and clicked
const DETAIL_PX = 40; // length of a boat on the screen below which its thrusters would be blots
const FOLLOW = 0.3; // share of the map at its edges that a followed boat is kept out of

const line = (options) => (map) => L.polyline([], { interactive: false, ...options }).addTo(map);
const area = (options) => (map) => L.polygon([], { interactive: false, ...options }).addTo(map);

/** Layers of one boat, made when first needed. */
class BoatLayers {
  constructor(map, name, onchoose) {
    this.map = map;
    this.name = name;
    this.onchoose = onchoose;
    this.made = new Map();
    this.once = "";
  }

  get(key, make) {
    let layer = this.made.get(key);
    if (!layer) this.made.set(key, (layer = make(this.map)));
    return layer;
  }

  set(key, places, make) {
    if (places?.length) this.get(key, make).setLatLngs(places);
    else this.drop(key);
  }

  drop(key) {
    this.made.get(key)?.remove();
    this.made.delete(key);
  }

  dropAll(prefix) {
    for (const key of [...this.made.keys()]) if (key.startsWith(prefix)) this.drop(key);
  }

  clear() {
    this.dropAll("");
  }
}

export class BoatMap {
  constructor(element, { label = "Map" } = {}) {
    this.element = element;
    element.setAttribute("role", "application");
    element.setAttribute("aria-label", label);
    this.map = L.map(element, {
      crs: L.CRS.Simple, attributionControl: false, zoomSnap: 0.25, zoomDelta: 0.5, minZoom: -6, maxZoom: 9,
      zoomAnimation: false, fadeAnimation: false, markerZoomAnimation: false, inertia: false, renderer: L.svg({ padding: 0.3 }),
    }).setView([0, 0], 4);
    this.map.createPane("boats").style.zIndex = 620; // above waypoints and anchors
    this.grid = new Grid(this.map);
    this.boats = new Map();
    this.follow = true;
    this.pick = null;
    this.onchoose = () => {};
    this.onfollow = () => {};
    this.map.on("dragstart", () => this.setFollow(false));
    this.map.on("click", ({ latlng }) => this.pick?.at([latlng.lat, latlng.lng]));
    element.addEventListener("keydown", (event) => {
      if (event.key !== "Enter" || event.target !== element || !this.pick) return;
      const { lat, lng } = this.map.getCenter();
      this.pick.at([lat, lng]);
    });
    this.resize = new ResizeObserver(() => this.map.invalidateSize({ animate: false }));
    this.resize.observe(element);
  }

  setFollow(follow) {
    this.follow = follow;
    this.onfollow(follow);
  }

  /** Let a tool have the clicks, and Enter for the middle: {at([n, e]), off(): another has them now}; null: nobody. */
  setPick(pick) {
    const before = this.pick;
    if (before === pick) return;
    this.pick = pick;
    before?.off();
    this.element.classList.toggle("picking", Boolean(this.pick));
    this.map.doubleClickZoom[this.pick ? "disable" : "enable"]();
  }

  /** Draw or move one boat. `view`: History.at; `chosen`: with path, horizon, ellipse, fence, anchors. */
  show(name, view, { track = [], stale = false, ended = false, colour = "var(--boat)", ghost = false, chosen = false } = {}) {
    const layers = this.boats.get(name) ?? new BoatLayers(this.map, name, () => this.pick || this.onchoose(name));
    this.boats.set(name, layers);
    const ink = stale ? GREY : colour;
    const { about } = view;
    const state = placed(view.state);
    const opacity = ended ? FADED : 1;
    this.showSite(layers, chosen ? about : null);
    if (chosen) this.grid.turn(about?.rotation_deg ?? 0);
    this.showPath(layers, chosen ? view : {});
    this.showAnchors(layers, chosen ? view : {}, stale);
    const trail = line({ weight: 2.5, opacity: 0.85, dashArray: ghost ? "2 6" : null });
    layers.set("track", track, trail);
    layers.made.get("track")?.setStyle({ color: ink, opacity: 0.85 * opacity });
    layers.set("horizon", chosen && !ghost && !stale ? fresh(view.horizon, state)?.poses.map(([n, e]) => [n, e]) : null,
      line({ color: COLOURS.horizon, weight: 3.5, dashArray: "1 6", lineCap: "round", pane: "boats" }));
    layers.set("ellipse", chosen && state ? ellipse(state) : null, area({ pane: "boats", weight: 1.5, fillOpacity: 0.15 }));
    layers.made.get("ellipse")?.setStyle({ color: ink, fillColor: ink });
    if (state) this.showHull(layers, { ...view, state }, { ink, ghost, stale, opacity });
    else for (const part of ["hull", "bow", "ring", "name", "force ", "head ", "thruster "]) layers.dropAll(part);
    if (chosen && state && this.follow && !this.pick) this.keepInSight([state.north_m, state.east_m]);
  }

  showHull(layers, { state, about, thrusters }, { ink, ghost, stale, opacity }) {
    const pane = "boats";
    const hull = area({ pane, weight: ghost ? 1.5 : 2.5, interactive: true, fillOpacity: ghost ? 0 : 0.55, fillColor: "var(--paper)", dashArray: ghost ? "4 3" : null });
    const place = [state.north_m, state.east_m];
    layers.set("hull", outline(state, about), hull);
    layers.set("bow", [place, toMap(state, sizeOf(about).length / 2, 0)], line({ pane, weight: 2}));
    const small = sizeOf(about).length * 2 ** this.map.getZoom() < SMALL_PX && !ghost;
    if (small) {
      layers.get("ring", (map) => L.circleMarker(place, { pane, radius: 11, weight: 3, fillOpacity: 0.25 }).addTo(map)).setLatLng(place);
      layers.made.get("ring").setStyle({ color: ink, fillColor: ink, opacity });
    } else layers.drop("ring");
    for (const key of ["hull", "bow"]) layers.made.get(key).setStyle({ color: ink, opacity: ghost && key === "bow" ? 0.6 : opacity });
    for (const key of ["hull", "ring"]) {
      const layer = layers.made.get(key);
      if (layer && !layer.listens("click")) layer.on("click", layers.onchoose);
    }
    if (!ghost) this.showName(layers, place, opacity, Math.max((sizeOf(about).length / 2) * 2 ** this.map.getZoom(), 12));
    this.showThrusters(layers, state, about, thrusters, ghost || stale, sizeOf(about).length * 2 ** this.map.getZoom() < DETAIL_PX);
  }

  /** The boat's name beside its hull, `away` pixels from its middle. */
  showName(layers, place, opacity, away) {
    const icon = L.divIcon({ className: "boat-name", html: "<span></span>", iconSize: [0, 0] });
    const marker = layers.get("name", (map) => L.marker(place, { icon, pane: "boats", interactive: false, keyboard: false }).addTo(map));
    const text = marker.setLatLng(place).getElement().firstChild;
    if (text.textContent !== layers.name) text.textContent = layers.name;
    text.style.opacity = opacity;
    text.style.left = `${0.8 * away + 2}px`;
    text.style.bottom = `${0.6 * away}px`;
  }

  showThrusters(layers, state, about, thrusters, still, tiny) {
    (about?.thrusters ?? []).forEach((thruster, k) => {
      const force = thrusters?.force_n[k];
      const shape = still || force === undefined ? null : arrow(state, about, thruster, force);
      const ink = force < 0 ? "var(--astern)" : "var(--ahead)";
      layers.set(`force ${k}`, shape?.line, line({ pane: "boats", weight: 4 }));
      layers.set(`head ${k}`, shape?.head, area({ pane: "boats", weight: 1, fillOpacity: 1 }));
      for (const key of [`force ${k}`, `head ${k}`]) layers.made.get(key)?.setStyle({ color: ink, fillColor: ink });
      const at = toMap(state, thruster.x_m, thruster.y_m);
      if (tiny) return layers.drop(`thruster ${k}`);
      layers.get(`thruster ${k}`, (map) => L.circleMarker(at, { pane: "boats", radius: 3, weight: 1, color: INK, fillColor: INK, fillOpacity: 1, interactive: false }).addTo(map)).setLatLng(at);
    });
  }

  /** Fences: what to stay inside of, and what to stay out of. */
  showSite(layers, about) {
    const key = about ? JSON.stringify([about.within, about.without]) : "";
    if (layers.once === key) return;
    layers.once = key;
    layers.dropAll("fence ");
    (about?.within ?? []).forEach((polygon, k) =>
      layers.set(`fence in ${k}`, polygon, area({ color: COLOURS.fence, weight: 3, fill: false, dashArray: "10 5" })));
    (about?.without ?? []).forEach((polygon, k) =>
      layers.set(`fence out ${k}`, polygon, area({ color: COLOURS.fence, weight: 3, fillOpacity: 0.25 })));
  }

  showPath(layers, { path, reference, state }) {
    const places = (path?.waypoints ?? []).map((w) => [w.north_m, w.east_m]);
    const passed = guided(reference, path)?.waypoints_passed ?? 0;
    const key = JSON.stringify([places, passed]);
    if (layers.path !== key) {
      layers.path = key;
      layers.dropAll("waypoint ");
      layers.set("path", places, line({ color: COLOURS.path, weight: 2, opacity: 0.9 }));
      places.forEach((place, k) => {
        const done = k < passed;
        layers.get(`waypoint ${k}`, (map) => L.marker(place, { interactive: false, keyboard: false, icon: L.divIcon({ className: `waypoint ${done ? "passed" : ""}`, html: `${k + 1}`, iconSize: [22, 22] }) }).addTo(map));
      });
    }
    if (!fresh(reference, state)) return layers.drop("reference");
    const asked = [reference.north_ref_m, reference.east_ref_m];
    layers.get("reference", (map) => L.circleMarker(asked, { radius: 5, color: COLOURS.path, weight: 2, fill: false, interactive: false }).addTo(map)).setLatLng(asked);
  }

  /** Anchors with what their last range was off by; red where the filter did not use it. */
  showAnchors(layers, { about, ranges, state }, stale) {
    const told = new Map((heard(ranges, state)?.ranges ?? []).map((r) => [r.anchor, r]));
    const anchors = about?.anchors ?? [];
    const wanted = anchors.map((a) => `${a.id} ${a.north_m} ${a.east_m}`).join();
    if (layers.anchors !== wanted) {
      layers.anchors = wanted;
      layers.dropAll("anchor ");
      for (const a of anchors) {
        layers.get(`anchor ${a.id}`, (map) => L.marker([a.north_m, a.east_m], { interactive: false, keyboard: false, icon: L.divIcon({ className: "anchor", html: "<i></i><b></b><span></span>", iconSize: [16, 16] }) }).addTo(map));
        layers.made.get(`anchor ${a.id}`).getElement().querySelector("b").textContent = a.id;
      }
    }
    for (const a of anchors) {
      const r = told.get(a.id);
      const element = layers.made.get(`anchor ${a.id}`).getElement();
      const residual = r?.residual_m;
      element.querySelector("span").textContent = !r ? "no range" : residual == null ? "range" : `${residual < 0 ? "−" : "+"}${Math.abs(residual).toFixed(2)} m`;
      element.classList.toggle("rejected", r?.accepted === false);
      element.classList.toggle("silent", !r || stale);
    }
  }

  keepInSight(place) {
    const size = this.map.getSize();
    const at = this.map.latLngToContainerPoint(place);
    const out = (value, whole) => value < whole * FOLLOW || value > whole * (1 - FOLLOW);
    if (size.x && (out(at.x, size.x) || out(at.y, size.y)) && !this.fitted?.pad(0.02).contains(place)) this.map.panTo(place, { animate: false });
  }

  forget(name) {
    this.boats.get(name)?.clear();
    this.boats.delete(name);
  }

  /** Zoom to a boat's fence, anchors, path and place. While it stays in there the map stands still. */
  fit(view) {
    const { about, path } = view;
    const state = placed(view.state);
    const places = [...(about?.within ?? []).flat(), ...(about?.anchors ?? []).map((a) => [a.north_m, a.east_m]),
      ...(path?.waypoints ?? []).map((w) => [w.north_m, w.east_m]), ...(state ? [[state.north_m, state.east_m]] : [])];
    if (!places.length) return;
    this.fitted = L.latLngBounds(places);
    this.map.invalidateSize({ animate: false }); // it may have been hidden until now
    this.map.fitBounds(this.fitted, { animate: false, maxZoom: 8, paddingTopLeft: [56, 24], paddingBottomRight: [72, 76] });
  }

  /** Zoom in on the boat itself. */
  near(view) {
    if (!placed(view.state)) return;
    this.fitted = null;
    const zoom = Math.log2((Math.min(...Object.values(this.map.getSize())) || 400) / (6 * sizeOf(view.about).length));
    this.map.setView([view.state.north_m, view.state.east_m], Math.min(Math.round(zoom * 4) / 4, 9), { animate: false });
  }

  destroy() {
    this.resize.disconnect();
    this.map.remove();
  }
}
