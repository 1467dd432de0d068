// Buttons and answers. STOP goes at once, with one click; what arms or moves the boat asks first. Nothing is modal:
// STOP can be reached at any time. What is shown is what the boat answered, or that no answer came, and how old it is.

import { make } from "./panels.js";
import { age, figure } from "./words.js";

const STOP_AGAIN_MS = 400;
const STOP_PATIENCE_MS = 15000; // so long a stop that found no console is said again
const ASK_MS = 15000; // an unanswered question goes away
const NEUTRAL_US = 1500;
const TRIED_MS = 20000; // so long after the click the console may be asked: a stop is tried for 15 s, and each try has 2 s
const SHOWN = 6; // or as many as there are boats, for a stop to all
const LONG_AGO_S = 600; // so old a failure may go like what was done (assumed)
const WORDS = { stop: "STOP", hold: "Hold", start: "Start", manual: "By hand", load_mission: "Load mission" };
const wait = (ms) => new Promise((done) => setTimeout(done, ms));

export class OrderDesk {
  /** connection; elements {stop, stopAll, hold, start, load, file, question, answers, says}; boats(): {chosen, all, view}. */
  constructor(connection, elements, boats) {
    this.connection = connection;
    this.elements = elements;
    this.boats = boats;
    this.given = new Map();
    this.local = 0;
    this.adopted = new Set(); // lines of the page's own that the console has told of since
    const { stop, stopAll, hold, start, load, file } = elements;
    stop.addEventListener("click", () => this.stop([this.boats().chosen]));
    stopAll.addEventListener("click", () => this.stop(this.boats().all));
    hold.addEventListener("click", () => this.ask("hold", "keeps station where it is. It arms if it is not armed."));
    start.addEventListener("click", () => this.ask("start", `drives its mission${this.missionName()}, or goes on with it. It arms if it is not armed.`));
    load.addEventListener("click", () => file.click());
    file.addEventListener("change", () => this.load());
    document.addEventListener("keydown", (event) => {
      if (event.key === "F9") event.repeat || this.stopOrSayWhyNot();
      else if (event.key === "Escape") this.dismiss();
      else return;
      event.preventDefault();
    });
  }

  missionName() {
    const name = this.boats().view?.path?.name;
    return name ? ` “${name}”` : "";
  }

  // --- what is given -------------------------------------------------------------------------------

  stopOrSayWhyNot() {
    const { stop, says } = this.elements;
    if (!stop.disabled) this.stop([this.boats().chosen]);
    else says.textContent = `STOP was not sent: ${this.boats().whyNot}.`;
  }

  stop(boats) {
    this.dismiss();
    this.giveStop(boats.filter(Boolean));
  }

  /** A stop to boats, all in one request: one that is dead keeps no other waiting. If no console is found it is said again for a while. */
  async giveStop(boats) {
    if (!boats.length) return;
    const shown = boats.map((boat) => this.begin({ boat, command: "stop" }));
    const end = performance.now() + STOP_PATIENCE_MS;
    for (let tries = 1, unsent = true; ; tries++) {
      const given = await this.connection.stop(boats);
      if (given.unreachable) given.tries = tries;
      if (!given.unreachable || performance.now() > end) return shown.forEach((mine, k) => this.told(mine, given[k] ?? given));
      this.connection.hurry();
      unsent &&= !this.connection.open;
      for (const mine of shown) this.show({ ...mine, unsent, tries, why: `${given.why} Trying again.` });
      await wait(STOP_AGAIN_MS);
    }
  }

  /** Another order than a stop. */
  async give(body) {
    const shown = this.begin(body);
    const given = await this.connection.order(body);
    this.told(shown, given);
    return { ...given, ...body };
  }

  /** A mission of one point, and its start; `leave`: the mission that is driven is left for it. The console gives the orders. */
  async driveThere(boat, mission, leave) {
    this.driving = boat;
    const shown = this.begin({ boat, command: leave ? "hold" : "load_mission" });
    this.told(shown, await this.connection.give("/drive_there", { boat, mission, leave }));
  }

  begin(body) {
    return this.show({ ...body, state: "sending", local: ++this.local, clicked_ms: performance.now(), tries: 0 });
  }

  /** What the console made of an order that this page gave. Where that is not known its own word of it counts. */
  told(shown, given) {
    this.given.delete(`local ${shown.local}`);
    if (given.unreachable && this.adopted.has(shown.local)) return;
    this.show({ ...given, boat: shown.boat, command: shown.command, local: given.number ? undefined : shown.local, clicked_ms: shown.clicked_ms });
  }

  ask(command, does, mission) {
    const { chosen } = this.boats();
    const body = { boat: chosen, command, ...(mission ? { mission } : {}) };
    if (chosen) this.confirm(WORDS[command], `${chosen} ${does}`, () => this.give(body));
  }

  /** What arms or moves the boat is done after a yes. `gone`: called when the question is gone, whatever the answer. */
  confirm(what, does, act, gone = () => {}) {
    this.dismiss();
    const { question } = this.elements;
    const yes = make("button", "yes", `Yes, ${what.toLowerCase()}`);
    const no = make("button", "no", "Cancel");
    const text = make("p", "", `${what}: ${does}`);
    text.id = "question-text";
    question.replaceChildren(text, yes, no);
    question.hidden = false;
    this.asking = document.activeElement;
    this.gone = gone;
    yes.addEventListener("keydown", (event) => event.repeat && event.preventDefault()); // the key that asked is still down
    yes.addEventListener("click", () => {
      this.dismiss();
      act();
    });
    no.addEventListener("click", () => this.dismiss());
    yes.focus();
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.dismiss(), ASK_MS);
  }

  dismiss() {
    const { question } = this.elements;
    if (question.hidden) return;
    const inside = question.contains(document.activeElement);
    question.hidden = true;
    question.replaceChildren();
    this.gone();
    if (inside) this.asking?.focus();
  }

  async load() {
    const { file } = this.elements;
    const [chosen] = file.files;
    if (!chosen) return;
    const mission = { name: chosen.name, text: await chosen.text() };
    file.value = "";
    this.ask("load_mission", `takes “${mission.name}” as its mission, from the first waypoint at the next start.`, mission);
  }

  // --- what came of it -----------------------------------------------------------------------------

  /** Note an order, from the console or of this page alone. */
  show(given) {
    const key = given.number ? `order ${given.number}` : `local ${given.local}`;
    let known = this.given.get(key);
    if (given.number && !known) known = this.adopt(given);
    if (given.state === "sending" && known?.number && known.state !== "sending") given = { clicked_ms: given.clicked_ms }; // the answer was quicker
    const merged = { ...known, ...given, clicked_ms: given.clicked_ms ?? known?.clicked_ms };
    this.given.delete(key);
    this.given.set(key, merged);
    while (this.given.size > Math.max(SHOWN, this.boats().all.length)) this.given.delete(this.leastNeeded());
    const said = this.words(merged);
    const settled = merged.state !== "sending" && merged.state !== known?.state;
    if (settled && (merged.clicked_ms || merged.boat === this.driving)) this.elements.says.textContent = said.join(" ");
    if (settled && merged.boat === this.driving && merged.command === "start") this.driving = null;
    this.draw();
    return merged;
  }

  /** The line that goes where there are too many: the oldest one that is done or of long ago, or else the oldest; not the newest. */
  leastNeeded() {
    const lines = [...this.given].slice(0, -1);
    const [key] = lines.find(([, given]) => this.kind(given) === "done" || this.age_s(given) > LONG_AGO_S) ?? lines[0];
    return key;
  }

  /** The page's own line for an order that the console now tells of under its number: one order, one line. */
  adopt({ boat, command, asked_ms }) {
    const at_ms = asked_ms - (this.connection.ahead_ms ?? 0); // on the page's clock
    for (const [key, mine] of this.given) {
      const open = mine.state === "sending" || (mine.unreachable && Math.abs(at_ms - mine.clicked_ms) < TRIED_MS);
      if (mine.number || !open || mine.boat !== boat || mine.command !== command) continue;
      this.given.delete(key);
      this.adopted.add(mine.local);
      return { clicked_ms: mine.clicked_ms };
    }
    return undefined;
  }

  /** A console that was started anew counts orders from 1 again: what the old one told is only ours now, and it answers no more. */
  restart() {
    for (const [key, given] of [...this.given]) {
      if (!given.number) continue;
      const left = given.state === "sending" ? { state: "no_answer", why: "The console was started anew meanwhile." } : {};
      this.given.delete(key);
      this.given.set(`local ${++this.local}`, { ...given, ...left, number: undefined, local: this.local, asked_ms: undefined, old_ms: performance.now() - (this.age_s(given) ?? 0) * 1e3 });
    }
  }

  /** What came of an order: a headline, and the rest. */
  words({ boat, command, state, why, tries, outcome, after_ms, unsent, unreachable }) {
    const what = `${WORDS[command]} → ${boat}`;
    if (state === "sending" && unsent) return [`${what}: NOT SENT yet (try ${tries}).`, why];
    if (state === "sending") return [`${what}: sent, no answer yet${tries > 1 ? ` (try ${tries})` : ""}.`, why ?? ""];
    if (state === "not_sent") return [`${what}: NOT SENT.`, why];
    if (state === "no_answer") return [`${what}: NO ANSWER after ${tries} ${tries === 1 ? "try" : "tries"}.`, unreachable ? `${why} The order may have come there.` : why];
    const status = { done: "done", waiting: "accepted, waits", refused: "REFUSED" }[outcome.status] ?? outcome.status;
    const mode = outcome.mode ? ` Mode ${outcome.mode}${outcome.why ? `: ${outcome.why}` : ""}.` : "";
    return [`${what}: ${status}, answered in ${figure(after_ms, 0, "ms")}.`, `“${outcome.text}”${mode}${why ? ` ${why}` : ""}`];
  }

  /** Seconds since it was given, or null. */
  age_s({ clicked_ms, asked_ms, old_ms }) {
    if (asked_ms) return (this.connection.console_ms() - asked_ms) / 1000;
    if (old_ms ?? clicked_ms) return (performance.now() - (old_ms ?? clicked_ms)) / 1000;
    return null;
  }

  kind(given) {
    const { state, outcome } = given;
    if (state === "sending") return "waits";
    if (this.neutral(given)[1]) return "failed";
    if (state === "answered") return outcome.status === "done" ? "done" : outcome.status === "waiting" ? "waits" : "failed";
    return "failed";
  }

  /** What telemetry since a stop's answer shows: pulses, and those that the autopilot says it gives; then, whether the
   * stop has not reached the thrusters. */
  neutral({ boat, command, state, outcome }) {
    if (command !== "stop" || state !== "answered" || outcome.status === "refused") return ["", false];
    const { view, chosen } = this.boats();
    const told = view?.thrusters;
    if (boat !== chosen || !told || told.run !== outcome.run || told.t_ns < outcome.t_ns) return ["", false];
    const still = (pulses) => pulses.every((p) => p === NEUTRAL_US || p === 0);
    if (!still(told.pwm_us)) return ["Now other pulses than neutral are sent.", false];
    if (told.sent === false) return ["NOT sent: no port to the autopilot is open.", true];
    if (!told.output_us) return ["Neutral is sent; the autopilot does not say what its outputs are.", false];
    return still(told.output_us) ? ["Neutral is sent, and the autopilot's outputs are neutral.", false] : ["Neutral is sent; the autopilot's outputs are NOT neutral.", true];
  }

  /** The list, the newest first. Called again and again: the ages go on. */
  draw() {
    const { answers } = this.elements;
    const list = [...this.given.values()].reverse();
    while (answers.children.length > list.length) answers.lastChild.remove();
    list.forEach((given, k) => {
      const item = answers.children[k] ?? answers.appendChild(make("li"));
      if (!item.firstChild) item.append(make("b"), make("span", "age"), make("span", "neutral"), make("span", "text"));
      item.dataset.kind = this.kind(given);
      item.dataset.command = given.command;
      item.dataset.state = given.state;
      const [headline, rest] = this.words(given);
      const old = this.age_s(given);
      const ago = old === null ? "" : `${age(old)} ago`;
      [headline, ago, this.neutral(given)[0], rest].forEach((text, i) => {
        if (item.children[i].textContent !== text) item.children[i].textContent = text;
      });
    });
  }
}
