// Figures, alerts and tables in words, beside the map.

import { compass, fresh, geodetic, guided, placed, sigma } from "./shapes.js";
import { age, clock, figure, heading, modeWords } from "./words.js";

const SHOWN_ALERTS = 60;
export const BATTERY_OLD_S = 10; // the autopilot reports it each second

/** An element with a class and a text. */
export function make(tag, className = "", text = "") {
  const element = document.createElement(tag);
  if (className) element.className = className;
  if (text) element.textContent = text;
  return element;
}

/** Texts by key into a list that keeps its elements, so that screen readers and selections are left in peace. */
function fill(list, rows) {
  const known = new Map([...list.children].map((item) => [item.dataset.key, item]));
  for (const [name, text, level] of rows) {
    let item = known.get(name);
    known.delete(name);
    if (!item) {
      item = list.appendChild(make("div"));
      item.dataset.key = name;
      item.append(make("dt", "", name), make("dd"));
    }
    const value = item.lastChild;
    if (value.textContent !== text) value.textContent = text;
    item.dataset.level = level || "";
  }
  for (const item of known.values()) item.remove();
}

const SI = { speed: { factor: 1, unit: "m/s", digits: 2 }, rate: { factor: 1, unit: "°/s", digits: 1 } };

/** Where the boat is and how it goes; units as of `Plots.setUnits`. */
export function showFigures(element, { state, about, reference, battery, thrusters, path }, { speed, rate } = SI) {
  const health = { healthy: "ok", degraded: "warning", lost: "error" }[state?.health] ?? "warning";
  const total = path?.waypoints?.length;
  const old = battery?.age_s > BATTERY_OLD_S ? `, ${age(battery.age_s)} ago` : "";
  const [latitude, longitude] = (placed(state) && geodetic(about, [state.north_m, state.east_m])) ?? [null, null];
  fill(element, [
    ["North", figure(placed(state)?.north_m, 2, "m")],
    ["East", figure(placed(state)?.east_m, 2, "m")],
    ["Latitude", figure(latitude, 7, "°")],
    ["Longitude", figure(longitude, 7, "°")],
    ["Heading", heading(compass(placed(state), about))],
    ["Speed", figure(placed(state) && Math.hypot(state.u_m_s, state.v_m_s) * speed.factor, speed.digits, speed.unit)],
    ["Yaw rate", figure(placed(state) && ((state.r_rad_s * 180) / Math.PI) * rate.factor, rate.digits, rate.unit)],
    ["Cross-track", figure(fresh(reference, state)?.y_e_m, 2, "m")],
    ["Position ±", figure(placed(state) && sigma(state.covariance), 2, "m")],
    ["Estimate", state ? state.health + (state.reason ? `: ${state.reason}` : "") : "not reported", state && health],
    ["Waypoints", total ? `${guided(reference, path)?.waypoints_passed ?? 0} of ${total}` : figure(null)],
    ["Battery", figure(battery?.voltage_v, 1, "V") + old, old && "warning"],
    ["Charge", figure(battery?.remaining_percent, 0, "%") + old, old && "warning"],
    ["Commands from", thrusters ? thrusters.source.replace("_", " ") : figure(null), thrusters && thrusters.reason && thrusters.source !== "neutral" ? "warning" : ""],
  ]);
}

/** Forces and pulses of every thruster, as bars and figures. */
export function showThrusters(element, { about, thrusters }) {
  const known = about?.thrusters ?? [];
  while (element.children.length > known.length) element.lastChild.remove();
  known.forEach((thruster, k) => {
    let item = element.children[k];
    if (!item) {
      item = element.appendChild(make("li"));
      const bar = make("span", "bar");
      bar.append(make("i"));
      item.append(make("span", "name"), bar, make("b"), make("span", "pulse"));
    }
    const force = thrusters?.force_n[k];
    const share = force === undefined ? 0 : Math.max(-1, Math.min(1, force / Math.max(thruster.force_max_n, -thruster.force_min_n, 0.1)));
    const fill = item.children[1].firstChild;
    fill.style.width = `${50 * Math.abs(share)}%`;
    fill.style.left = `${share < 0 ? 50 * (1 + share) : 50}%`;
    fill.classList.toggle("astern", share < 0);
    const given = thrusters?.output_us?.[k];
    const pulse = thrusters ? `${thrusters.pwm_us[k]} µs ${thrusters.sent === false ? "NOT sent" : "sent"}${given == null ? "" : `, ${given} given`}` : "";
    [thruster.name, null, figure(force, 1, "N"), pulse].forEach((text, i) => {
      if (text !== null && item.children[i].textContent !== text) item.children[i].textContent = text;
    });
  });
}

/** Mode in large letters, and why. */
export function showMode(element, { mode }) {
  const [word, kind] = modeWords(mode);
  const text = `${word}|${mode?.why ?? ""}|${mode?.armed}|${kind}`;
  if (element.dataset.shown === text) return;
  element.dataset.shown = text;
  element.dataset.kind = kind;
  const armed = mode && !mode.ended ? (mode.armed === null ? "autopilot silent" : mode.armed ? "armed" : "disarmed") : "";
  element.replaceChildren(make("strong", "", word), make("span", "armed", armed), make("span", "why", mode?.why ?? ""));
}

/** What people should know, the newest first. t_s: as it was known then. */
export function showAlerts(element, alerts, t_s = Infinity, unix_minus_t_ns = 0) {
  const known = alerts.filter((a) => a.t_ns * 1e-9 <= t_s).slice(-SHOWN_ALERTS).reverse();
  const key = `${known.length} ${known[0]?.t_ns} ${known[0]?.text} ${unix_minus_t_ns}`;
  if (element.dataset.shown === key) return;
  element.dataset.shown = key;
  element.replaceChildren(
    ...known.map((alert) => {
      const item = make("li", alert.level);
      const word = { error: "Error", warning: "Warning", info: "Note" }[alert.level];
      item.append(make("span", "badge", word), make("time", "", clock(alert.t_ns, unix_minus_t_ns)), make("span", "text", alert.text));
      return item;
    }),
  );
  if (!known.length) element.append(make("li", "none", "None so far."));
}

const LEVELS = { ok: "OK", warning: "Warning", refuse: "Refused" };
const GRAVEST = ["refuse", "warning", "ok"];

/** The boat's pre-flight table; what needs a person's care first. */
export function showChecks(element, checks) {
  const key = checks ? `${checks.run} ${checks.t_ns}` : "none";
  if (element.dataset.shown === key) return;
  element.dataset.shown = key;
  if (!checks) return element.replaceChildren(make("p", "none", "Not reported yet: the boat checks once the autopilot has given its parameters."));
  const order = GRAVEST.flatMap((level) => checks.rows.filter((row) => row.level === level));
  const table = make("table");
  const head = table.createTHead().insertRow();
  for (const name of ["", "What", "Found", "Needed", "How to fix it"]) head.append(Object.assign(make("th", "", name), { scope: "col" }));
  head.firstChild.append(make("span", "hidden", "Verdict"));
  const body = table.createTBody();
  for (const row of order) {
    const line = body.insertRow();
    line.className = row.level;
    line.insertCell().append(make("span", "badge", LEVELS[row.level] ?? row.level));
    line.append(Object.assign(make("th", "", `${row.area}: ${row.name}`), { scope: "row" }));
    for (const text of [row.found, row.needed, row.level === "ok" ? row.why : [row.why, row.fix].filter(Boolean).join(" ")]) line.insertCell().textContent = text ?? "";
  }
  element.replaceChildren(table);
}

/** Links of the boat, and what its program costs. */
export function showLinks(element, links, timing) {
  const rows = (links?.links ?? []).map((l) => [l.link, l.state + (l.reason ? `: ${l.reason}` : ""), l.state === "online" ? "ok" : "warning"]);
  for (const [name, seconds] of Object.entries(links?.ages_s ?? {})) rows.push([`last ${name}`, seconds === null ? "never" : `${age(seconds)} ago`, seconds !== null && seconds < 3 ? "" : "warning"]);
  for (const [name, text] of Object.entries(links?.figures ?? {})) rows.push([name, text]);
  if (timing) {
    rows.push(["IMU to override", `${figure(timing.imu_to_override.median_ms, 1)} / ${figure(timing.imu_to_override.max_ms, 1, "ms")}`]);
    rows.push(["processor, memory", `${figure(timing.cpu_percent, 0, "%")}, ${figure(timing.rss_mb, 0, "MB")}`]);
    rows.push(["telemetry dropped", String(timing.dropped), timing.dropped ? "warning" : ""]);
    rows.push(["orders refused", String(timing.refused), timing.refused ? "warning" : ""]);
  }
  fill(element, rows);
}
