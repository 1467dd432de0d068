// The live page: what the console hears of every boat, one of them closely.

import { Connection } from "./connection.js";
import { History } from "./history.js";
import { BoatMap } from "./map.js";
import { OrderDesk } from "./orders.js";
import { make, showAlerts, showChecks, showFigures, showLinks, showMode, showThrusters } from "./panels.js";
import { Plots } from "./plots.js";
import { age, modeWords } from "./words.js";

const KEPT_S = 150; // of the chosen boat; of the others only what the list and the map need
const OTHERS_S = 5;
const STALE_S = 1.5; // a boat tells its state ten times a second
const LOST_S = 5;
const PLOTS_MS = 200;
const LOOK_MS = 250;
const $ = (id) => document.getElementById(id);

const history = new History({ keep_s: OTHERS_S });
const clocks = new Map(); // boat -> [its clock minus the console's, ms; whether its token is there; programs of its name; why it gets no orders]
const drawn = new Map(); // boat -> how often it was drawn, for measurements
const changed = new Set();
const map = new BoatMap($("map"), { label: "Map of the boats, metres, north up. Arrow keys move it, plus and minus zoom." });
const plots = new Plots($("plots"));
let chosen = null;
let fitted = null;
let window_s = Number($("window").value);
let plotted_ms = 0;
let commands = false;
let zenoh = "";
let started = null; // which run of the console program this page has spoken to

const connection = new Connection({ onframe, onconsole, onorder: (given) => desk.show(given) });
const elements = {
  stop: $("stop"), stopAll: $("stop-all"), hold: $("hold"), start: $("start"), load: $("load"), file: $("file"),
  question: $("question"), answers: $("answers"), says: $("says"),
};
const desk = new OrderDesk(connection, elements, () => ({ chosen, all: history.boats(), view: chosen && history.at(chosen) }));

function onconsole(about) {
  if (started !== null && started !== about.started) desk.restart();
  started = about.started;
  commands = about.commands;
  zenoh = about.problem ? `Zenoh: ${about.problem}` : "";
  look();
}

function onframe(frame) {
  for (const [boat, clock] of Object.entries(frame.clocks)) clocks.set(boat, clock);
  for (const sample of frame.samples) if (history.push(sample)) changed.add(sample.boat);
  if (!chosen || !history.boats().includes(chosen)) choose(remembered() ?? history.boats()[0] ?? null);
  requestAnimationFrame(draw);
}

function remembered() {
  const name = decodeURIComponent(location.hash.slice(1));
  return history.boats().includes(name) ? name : null;
}

function choose(boat) {
  if (!boat || boat === chosen) return;
  if (chosen) {
    history.keep(chosen, OTHERS_S);
    changed.add(chosen);
  }
  chosen = boat;
  history.keep(boat, KEPT_S);
  changed.add(boat);
  fitted = null;
  globalThis.history.replaceState(null, "", `#${encodeURIComponent(boat)}`);
  connection.choose(boat);
  desk.dismiss();
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
  for (const boat of changed) {
    const close = boat === chosen;
    const view = close ? history.at(boat) : { state: history.last(boat, "state"), about: history.last(boat, "about") };
    map.show(boat, view, { track: close ? history.track(boat) : [], chosen: close, stale: stale(boat), colour: close ? "#0b3d91" : "#3d4a55" });
    drawn.set(boat, (drawn.get(boat) ?? 0) + 1);
    if (close) showChosen(view);
  }
  changed.clear();
}

function showChosen(view) {
  if (fitted !== chosen && view.state && view.about) {
    fitted = chosen;
    map.fit(view);
  }
  showFigures($("figures"), view);
  showThrusters($("thrusters"), view);
  showMode($("mode"), view);
  showLinks($("links"), view.links, view.timing);
  showChecks($("checks"), view.checks);
  showAlerts($("alerts"), history.list(chosen, "alert"), Infinity, view.about?.unix_minus_t_ns);
  const resumes = ["hold", "idle", "safe"].includes(view.mode?.mode) && view.reference;
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

/** What changes by itself: ages, what is stale, the list of boats. */
function look() {
  const old = age_s(chosen);
  const isStale = stale(chosen);
  const link = $("link");
  link.dataset.kind = !connection.open || old === null || old > LOST_S ? "lost" : isStale ? "stale" : "live";
  const text = lineState(old);
  if ($("link-text").textContent !== text.long) $("link-text").textContent = text.long;
  $("age").textContent = old === null ? "–" : age(old);
  if (link.dataset.said !== text.short) {
    link.dataset.said = text.short;
    $("link-says").textContent = text.short;
  }
  if (document.body.classList.toggle("stale", isStale) !== look.was && chosen) changed.add(chosen);
  look.was = isStale;
  const problem = [zenoh, sharedNames()].filter(Boolean).join(" ");
  if ($("problem").textContent !== problem) $("problem").textContent = problem;
  const note = $("stale-note");
  note.hidden = !isStale || !chosen;
  note.textContent = old === null ? "" : `Last known, ${age(old)} old`;
  const about = chosen && history.last(chosen, "about");
  const can = Boolean(chosen && commands && about?.commands);
  for (const key of ["stop", "hold", "start", "load"]) elements[key].disabled = key === "stop" ? !chosen || !commands : !can;
  elements.stopAll.hidden = history.boats().length < 2;
  elements.stopAll.disabled = !commands;
  const count = history.boats().length;
  if (count > 1) elements.stopAll.textContent = `STOP ALL ${count}`;
  const why = !chosen ? "" : !commands ? "This console has no command key: it only looks." : about && !about.commands ? `${chosen} takes no orders from shore.` : (clocks.get(chosen)?.[3] ?? "");
  if ($("no-orders").textContent !== why) $("no-orders").textContent = why;
  desk.draw();
  showBoats();
  drawPlots();
  if (changed.size) requestAnimationFrame(draw);
}

/** Names that several programs have: what is shown of such a boat is one of them. */
function sharedNames() {
  const names = history.boats().filter((boat) => clocks.get(boat)?.[2] > 1);
  if (!names.length) return "";
  return `NAME TAKEN TWICE: ${names.map((name) => `${clocks.get(name)[2]} programs call themselves ${name}`).join("; ")}. STOP goes to all of them, other orders to none; only one is shown.`;
}

function lineState(old) {
  if (!connection.open) {
    const seconds = connection.silence_s();
    return { short: "Connection to the console lost", long: `No connection to the console program for ${age(seconds)}: trying again` };
  }
  if (!chosen) return { short: "No boat yet", long: "Connected to the console; no boat was heard of yet" };
  if (old > STALE_S) {
    const there = clocks.get(chosen)?.[1] ? "its program can be reached" : "its program cannot be reached";
    return { short: `No word from ${chosen}`, long: `No word from ${chosen} for ${age(old)}; ${there}` };
  }
  return { short: `${chosen} is live`, long: `${chosen} is live` };
}

function showBoats() {
  const names = history.boats();
  const list = $("boat-list");
  document.body.classList.toggle("fleet", names.length > 1);
  if (names.length < 2) return list.replaceChildren();
  names.forEach((name, k) => {
    let button = list.children[k]?.firstChild;
    if (!button) {
      button = make("button", "boat");
      button.append(make("b"), make("span", "boat-mode"), make("span", "boat-age"));
      button.addEventListener("click", () => choose(button.dataset.boat));
      const item = make("li");
      item.append(button);
      list.append(item);
    }
    const mode = history.last(name, "mode");
    const [word, kind] = modeWords(mode);
    const old = age_s(name);
    const texts = [clocks.get(name)?.[2] > 1 ? `${name} ×${clocks.get(name)[2]}` : name, word, old === null ? "never" : age(old)];
    button.dataset.boat = name;
    texts.forEach((text, i) => {
      if (button.children[i].textContent !== text) button.children[i].textContent = text;
    });
    button.dataset.kind = stale(name) ? "unknown" : kind;
    button.setAttribute("aria-pressed", String(name === chosen));
  });
  while (list.children.length > names.length) list.lastChild.remove();
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
document.addEventListener("visibilitychange", () => {
  if (chosen) changed.add(chosen);
  look();
});
setInterval(look, LOOK_MS);
look();

globalThis.aritra = { history, connection, drawn, map, age_s, choose }; // for tests and the curious
