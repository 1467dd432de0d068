// The live page: what the console hears of every boat, one of them closely.

import { Alarms } from "./alarms.js";
import { Attitude } from "./attitude.js";
import { BoatList } from "./boat_list.js";
import { Connection } from "./connection.js";
import { Fleet, LOST_S } from "./fleet.js";
import { History } from "./history.js";
import { showLogs } from "./logs.js";
import { BoatMap } from "./map.js";
import { DriveHere } from "./mission/drive_here.js";
import { FenceEditor } from "./mission/fence.js";
import { MissionEditor } from "./mission/editor.js";
import { Steering } from "./driving/steer.js";
import { OrderDesk } from "./orders.js";
import { make, showAlerts, showChecks, showFigures, showLinks, showMode, showThrusters } from "./panels.js";
import { ALL, Preferences } from "./preferences.js";
import { Plots } from "./plots.js";
import { themeSwitch } from "./theme.js";
import { guided, inSite, placed } from "./shapes.js";
import { age, modeWords } from "./words.js";

const KEPT_S = 600; // of the chosen boat; of the others only what the list and the map need
const OTHERS_S = 5;
const STALE_S = 1.5; // a boat tells its state ten times a second
const PLOTS_MS = 200;
const LOOK_MS = 250;
const $ = (id) => document.getElementById(id);

const history = new History({ keep_s: OTHERS_S });
const clocks = new Map(); // boat -> what `Fleet` says
const fleet = new Fleet(history, clocks, age_s);
const drawn = new Map(); // boat -> how often it was drawn, for measurements
const changed = new Set();
const map = new BoatMap($("map"), { label: "Map of the boats, metres, north up. Arrow keys move it, plus and minus zoom." });
const plots = new Plots($("plots"), { panels: ALL });
const preferences = new Preferences({ plots, choice: $("plot-choice").lastElementChild, units: $("units"), changed: () => chosen && changed.add(chosen) });
const attitude = new Attitude($("attitude"));
const alarms = new Alarms($("alarms"));
let chosen = null;
let fitted = null;
let window_s = Number($("window").value);
let plotted_ms = 0;
let commands = false;
let zenoh = "";
let whyNot = "";
let can = false; // whether the chosen boat can be given orders that ask first
let started = null; // which run of the console program this page has spoken to

const connection = new Connection({ onframe, onconsole, onorder: (given) => {
  desk.show(given);
  steering.note(given);
} });
const elements = {
  stop: $("stop"), stopAll: $("stop-all"), hold: $("hold"), start: $("start"), load: $("load"), file: $("file"),
  question: $("question"), answers: $("answers"), says: $("says"),
};
const boatList = new BoatList($("boat-list"), { choose, putAway });
const desk = new OrderDesk(connection, elements, () => ({ chosen, all: fleet.stoppable(commands), whyNot, view: chosen && history.at(chosen) }));
const shown = () => ({ boat: chosen, view: chosen && history.at(chosen), can });
const editor = new MissionEditor({ map, desk, connection, button: $("draw"), chosen: shown });
new FenceEditor({ map, connection, button: $("draw-fence") });
const steering = new Steering({ desk, connection, button: $("steer"), chosen: shown });
const driveHere = new DriveHere({ map, desk, button: $("drive-here"), note: $("map-note"), chosen: shown });

function onconsole(about) {
  if (started !== null && started !== about.started) [desk, fleet, steering].forEach((part) => part.restart());
  $("log-box").hidden = !about.logs;
  if (about.logs && started !== about.started) showLogs($("logs"));
  started = about.started;
  commands = about.commands;
  zenoh = about.problem ? `Zenoh: ${about.problem}` : "";
  $("hears").textContent = about.where ? `This console is ${about.where}.` : "";
  look();
}

function onframe(frame) {
  fleet.hear(frame.clocks, connection.ahead_ms);
  for (const sample of frame.samples) if (history.push(sample)) take(sample);
  if (!chosen) look();
  requestAnimationFrame(draw);
}

function take({ boat, topic, sample }) {
  changed.add(boat);
  if (topic === "alert") alarms.alert(boat, sample, boat_now_s(boat) - sample.t_ns * 1e-9);
}

/** What lasts and should be heard: no console, a boat that fell silent or is in `safe`. */
function sound() {
  alarms.stands("console", "error", !connection.open && connection.silence_s() > LOST_S ? "The console program does not answer." : null);
  for (const boat of connection.open ? fleet.names() : []) {
    const silent = !fleet.ended(boat) && age_s(boat) > LOST_S;
    alarms.stands(`silent ${boat}`, "error", silent ? `No word from ${boat}.` : null);
    const mode = history.last(boat, "mode");
    alarms.stands(`safe ${boat}`, "error", mode?.mode === "safe" ? `${boat} is in safe: ${mode.why}` : null);
  }
}

function remembered() {
  const name = decodeURIComponent(location.hash.slice(1));
  return fleet.names().includes(name) ? name : null;
}

function choose(boat) {
  if (boat === chosen) return;
  if (chosen) history.keep(chosen, OTHERS_S);
  chosen = boat;
  desk.dismiss();
  if (map.pick === driveHere.pick) map.setPick(null);
  fitted = null;
  if (!boat) return look();
  history.keep(boat, KEPT_S);
  fleet.names().forEach((name) => changed.add(name));
  globalThis.history.replaceState(null, "", `#${encodeURIComponent(boat)}`);
  connection.choose(boat);
  look();
  requestAnimationFrame(draw);
}

// --- time ------------------------------------------------------------------------------------------

/** Now on a boat's clock [s]: as fresh as its quickest sample. Goes on without any word from it. */
function boat_now_s(boat) {
  const clock = clocks.get(boat);
  return clock ? (connection.console_ms() + clock[0]) / 1000 : (history.newest(boat) ?? 0);
}

/** Age of the newest word of a boat [s], or null. */
function age_s(boat) {
  const newest = boat && history.newest(boat);
  return newest ? Math.max(boat_now_s(boat) - newest, 0) : null;
}

// --- drawing ---------------------------------------------------------------------------------------

function draw() {
  if (document.hidden || !changed.size) return;
  const site = chosen && history.last(chosen, "about"); // in whose axes the map is
  for (const boat of changed) {
    if (fleet.away.has(boat)) {
      map.forget(boat);
      continue;
    }
    const close = boat === chosen;
    const about = history.last(boat, "about");
    const view = close ? history.at(boat) : { about, state: inSite(history.last(boat, "state"), about, site) };
    map.show(boat, view, { track: close ? history.track(boat) : [], chosen: close, stale: stale(boat), ended: fleet.ended(boat), colour: close ? "var(--boat)" : "var(--other)" });
    drawn.set(boat, (drawn.get(boat) ?? 0) + 1);
    if (close) showChosen(view);
  }
  changed.clear();
}

function showChosen(view) {
  if (fitted !== chosen && view.about && (view.about.within.length || placed(view.state))) {
    fitted = chosen;
    map.fit(view);
  }
  showFigures($("figures"), view, preferences.units);
  attitude.show(view);
  showThrusters($("thrusters"), view);
  showMode($("mode"), view);
  showLinks($("links"), view.links, view.timing);
  showChecks($("checks"), view.checks);
  showAlerts($("alerts"), history.list(chosen, "alert"), Infinity, view.about?.unix_minus_t_ns);
  const resumes = ["hold", "idle", "safe"].includes(view.mode?.mode) && guided(view.reference, view.path);
  $("start").textContent = resumes ? "Resume…" : "Start…";
}

function drawPlots() {
  if (!chosen || document.hidden || performance.now() - plotted_ms < PLOTS_MS) return;
  plotted_ms = performance.now();
  const now_s = boat_now_s(chosen);
  plots.draw([{ history, boat: chosen }], { from_s: now_s - window_s, to_s: now_s, zero_s: now_s });
}

function stale(boat) {
  const old = age_s(boat);
  return old === null || old > STALE_S || !connection.open;
}

/** What changes by itself: ages, what is stale, the list of boats, what can be ordered. */
function look() {
  if (!fleet.names().includes(chosen)) choose(remembered() ?? fleet.names().find((boat) => !fleet.ended(boat)) ?? fleet.names()[0] ?? null);
  document.body.classList.toggle("empty", !chosen);
  const old = age_s(chosen);
  const isStale = Boolean(chosen) && stale(chosen);
  const link = $("link");
  link.dataset.kind = linkKind(old, isStale);
  const text = lineState(old);
  say("link-text", text.long);
  say("link-says", text.short);
  say("age", old === null ? "–" : age(old));
  if (document.body.classList.toggle("stale", isStale) !== look.was && chosen) changed.add(chosen);
  look.was = isStale;
  say("problem", [zenoh, sharedNames()].filter(Boolean).join(" "));
  const note = $("stale-note");
  note.hidden = !isStale;
  note.textContent = old === null ? "" : `Last known, ${age(old)} old`;
  showOrders();
  driveHere.look();
  editor.look();
  sound();
  desk.draw();
  showBoats();
  drawPlots();
  if (changed.size) requestAnimationFrame(draw);
}

/** A text, set where it changed: screen readers tell of it. */
function say(id, text) {
  if ($(id).textContent !== text) $(id).textContent = text;
}

function linkKind(old, isStale) {
  if (!connection.open) return "lost";
  if (chosen && fleet.ended(chosen)) return "ended";
  return old === null || old > LOST_S ? "lost" : isStale ? "stale" : "live";
}

/** Which orders can be given, and why a STOP cannot, before somebody needs it. */
function showOrders() {
  const no = fleet.noStop(chosen, commands);
  can = !no && Boolean(history.last(chosen, "about")?.commands);
  elements.stop.disabled = Boolean(no);
  for (const key of ["hold", "start", "load"]) elements[key].disabled = !can;
  whyNot = no ? no[0] : "";
  say("stop-whom", no ? (chosen ? `cannot: ${no[0]}` : no[0]) : chosen);
  say("no-orders", no ? no[1] : fleet.doubt(chosen));
  const reached = fleet.stoppable(commands).filter((boat) => !fleet.lost(boat)).length;
  elements.stopAll.hidden = fleet.names().length < 2;
  elements.stopAll.disabled = !fleet.stoppable(commands).length;
  say("stop-all", `STOP ALL ${reached}`);
}

/** Names that several programs have: what is shown of such a boat is one of them. */
function sharedNames() {
  const names = fleet.names().filter((boat) => clocks.get(boat)?.[2] > 1);
  if (!names.length) return "";
  return `NAME TAKEN TWICE: ${names.map((name) => `${clocks.get(name)[2]} programs call themselves ${name}`).join("; ")}. STOP goes to all of them, other orders to none; only one is shown.`;
}

function lineState(old) {
  if (!connection.open) {
    const seconds = connection.silence_s();
    return { short: "Connection to the console lost", long: `No connection to the console program for ${age(seconds)}: trying again` };
  }
  if (!chosen) return { short: "No boat yet", long: "Connected to the console; no boat was heard of yet" };
  if (fleet.ended(chosen)) return { short: `${chosen} has ended`, long: `${chosen} has ended; its last word` };
  if (old > STALE_S) {
    const there = clocks.get(chosen)?.[1] ? "its program can be reached" : "its program cannot be reached";
    return { short: `No word from ${chosen}`, long: `No word from ${chosen} for ${age(old)}; ${there}` };
  }
  return { short: `${chosen} is live`, long: `${chosen} is live` };
}

function showBoats() {
  const names = fleet.names();
  document.body.classList.toggle("fleet", names.length > 1);
  boatList.show(names.length > 1 ? names : [], (name) => {
    const old = age_s(name);
    const [word, kind] = modeWords(history.last(name, "mode"));
    return {
      name, word, kind: stale(name) && kind !== "ended" ? "unknown" : kind, programs: clocks.get(name)?.[2] ?? 1,
      old: old === null ? "never" : age(old), chosen: name === chosen, gone: fleet.ended(name) || fleet.lost(name),
    };
  });
}

function putAway(boat) {
  fleet.putAway(boat);
  changed.add(boat);
  look();
}

// --- the page's own buttons ------------------------------------------------------------------------

map.onchoose = choose;
map.onfollow = (follow) => $("follow").setAttribute("aria-pressed", String(follow));
$("fit").addEventListener("click", () => chosen && map.fit(history.at(chosen)));
$("near").addEventListener("click", () => {
  map.setFollow(true);
  if (chosen) map.near(history.at(chosen));
});
$("follow").addEventListener("click", () => map.setFollow(!map.follow));
$("window").addEventListener("change", (event) => {
  window_s = Number(event.target.value);
});
$("log-again").addEventListener("click", () => showLogs($("logs")));
document.addEventListener("visibilitychange", () => {
  if (chosen) changed.add(chosen);
  look();
});
themeSwitch($("theme"));
setInterval(look, LOOK_MS);
look();

globalThis.aritra = { history, connection, drawn, map, age_s, choose, fleet, editor, steering }; // for tests and the curious
