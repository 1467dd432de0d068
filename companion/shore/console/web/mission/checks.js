// What is wrong with a drawn mission, before the boat says it (it checks again, and its word counts). Pure: no DOM.

import { figure } from "../words.js";
import { toToml } from "./plan.js";

const SHORTEST_LEG_M = 0.05; // companion.core.guidance.path
const MOST_BYTES = 64000; // an order may have 65,536 (companion.core.telemetry.order_gate); the rest is for what is beside the mission

/** Distance of a place to a polygon's edge [m], negative outside (even-odd rule); companion.core.geometry.fence. */
function inside(polygon, [north, east]) {
  let nearest = Infinity;
  let within = false;
  polygon.forEach(([n1, e1], k) => {
    const [n2, e2] = polygon[(k + 1) % polygon.length];
    const [dn, de] = [n2 - n1, e2 - e1];
    const along = Math.max(0, Math.min(1, ((north - n1) * dn + (east - e1) * de) / (dn * dn + de * de)));
    nearest = Math.min(nearest, Math.hypot(n1 + along * dn - north, e1 + along * de - east));
    if (n1 > north !== n2 > north && east < e1 + ((north - n1) / dn) * de) within = !within;
  });
  return within ? nearest : -nearest;
}

/** Distance to the nearest fence [m], negative beyond it; `about` as the boat tells it. */
export function clearance({ within, without }, place) {
  return Math.min(Infinity, ...within.map((p) => inside(p, place)), ...without.map((p) => -inside(p, place)));
}

const turn = ([an, ae], [bn, be], [cn, ce]) => (bn - an) * (ce - ae) - (be - ae) * (cn - an);

/** Whether the straight leg between two places that are inside leaves the fence. */
export function leaves({ within, without }, a, b) {
  return [...within, ...without].some((polygon) =>
    polygon.some((c, k) => {
      const d = polygon[(k + 1) % polygon.length];
      return turn(a, b, c) * turn(a, b, d) < 0 && turn(c, d, a) * turn(c, d, b) < 0;
    }));
}

const place = ({ north_m, east_m }) => [north_m, east_m];

/** Length of each leg [m]; the first waypoint has none. */
export function legs(waypoints) {
  return waypoints.map((w, k) => (k ? Math.hypot(w.north_m - waypoints[k - 1].north_m, w.east_m - waypoints[k - 1].east_m) : null));
}

/** Problems, in order: {at, grave, text}; `at`: number of the waypoint, null: the mission; grave: the boat would refuse it. */
export function problems(plan, about) {
  const found = [];
  const say = (at, text, grave = true) => found.push({ at, grave, text: at === null ? text : `Waypoint ${at + 1} ${text}` });
  const { waypoints } = plan;
  if (!waypoints.length) say(null, "No waypoint yet: click on the map, or add one.");
  if (!about) say(null, "The boat has not reported its fence yet: nothing is checked against it.", false);
  const lengths = legs(waypoints);
  waypoints.forEach((w, k) => {
    if (!place(w).every(Number.isFinite)) return say(k, "is no place.");
    if (w.speed_m_s !== null && !(w.speed_m_s > 0)) say(k, "needs a speed above 0, or none.");
    if (w.acceptance_m !== null && !(w.acceptance_m > 0)) say(k, "needs an acceptance radius above 0, or none.");
    if (k && lengths[k] < SHORTEST_LEG_M) say(k, `lies within ${SHORTEST_LEG_M} m of the one before it.`);
    if (!about) return;
    const room = clearance(about, place(w));
    if (room < 0) say(k, `lies ${figure(-room, 1, "m")} beyond the fence.`);
    else if (k && leaves(about, place(waypoints[k - 1]), place(w))) say(k, "is reached by a leg that leaves the fence.", false);
  });
  const size = new TextEncoder().encode(JSON.stringify(toToml(plan))).length;
  if (size > MOST_BYTES) say(null, `The mission is too long for one order: ${Math.ceil(size / 1000)} kB of ${MOST_BYTES / 1000}.`);
  return found;
}
