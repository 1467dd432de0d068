// The drawn mission on the map: legs, and waypoints that can be dragged.

const L = globalThis.L;

const SIZE_PX = 26;
const icon = (k) => L.divIcon({ className: "draft-point", html: String(k + 1), iconSize: [SIZE_PX, SIZE_PX] });

export class MissionLayer {
  /** move(k, [n, e], done): dragged, `done`: let go of; remove(k); insert(k, [n, e]): before the k-th. */
  constructor(map, { move, remove, insert }) {
    Object.assign(this, { map, move, remove, insert, points: [], shown: [] });
    for (const [pane, z] of [["draft-line", 610], ["draft", 640]]) (map.getPane(pane) ?? map.createPane(pane)).style.zIndex = z; // below and above the boats
    this.group = L.layerGroup().addTo(map);
    this.line = L.polyline([], { className: "draft-line", color: "var(--draft)", weight: 3, dashArray: "6 5", pane: "draft-line", bubblingMouseEvents: false }).addTo(this.group);
    this.course = L.polyline([], { className: "draft-course", color: "var(--draft)", weight: 5, opacity: 0.45, pane: "draft-line", interactive: false }).addTo(this.group);
    this.line.on("click", ({ latlng }) => this.insert(this.legAt(latlng), [latlng.lat, latlng.lng]));
  }

  /** wrong: numbers of waypoints that are wrong; course: as it would be driven, where that is known. */
  show(waypoints, wrong = new Set(), course = []) {
    this.course.setLatLngs(course);
    const places = waypoints.map((w) => [w.north_m, w.east_m]);
    this.line.setLatLngs(places);
    while (this.points.length > places.length) this.group.removeLayer(this.points.pop());
    places.forEach((place, k) => {
      const point = this.points[k] ?? this.add(k, place);
      point.setLatLng(place);
      point.getElement().classList.toggle("wrong", wrong.has(k)); // another icon would make a click of the end of a drag
    });
  }

  add(k, place) {
    const point = L.marker(place, { icon: icon(k), draggable: true, autoPan: true, keyboard: false, pane: "draft" }).addTo(this.group);
    const told = (done) => () => this.move(k, [point.getLatLng().lat, point.getLatLng().lng], done);
    point.on("drag", told(false)).on("dragend", told(true)).on("contextmenu", () => this.remove(k));
    return (this.points[k] = point);
  }

  /** Number of the waypoint at the end of the leg that is nearest to a place. */
  legAt(latlng) {
    const at = this.map.latLngToLayerPoint(latlng);
    const ends = this.line.getLatLngs().map((l) => this.map.latLngToLayerPoint(l));
    const away = ends.slice(1).map((end, k) => L.LineUtil.pointToSegmentDistance(at, ends[k], end));
    return away.indexOf(Math.min(...away)) + 1;
  }

  hide() {
    this.show([]);
  }
}
