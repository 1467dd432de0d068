// Driving by hand: a gamepad or two thumbs, with a dead man's button, to the boat that was given to this page. A place of
// the sticks is sent 20 times a second while they are this page's; the console signs it, and the boat's own dead man ends
// in neutral 0.5 s after the last. Whatever ends it here, a last word says that nobody holds them.

import { figure } from "../words.js";
import { Grip, NOBODY, Pad, shaped } from "./shares.js";
import { TouchSticks } from "./touch.js";

const PERIOD_MS = 50; // a browser slows it down to 1 s in a tab that is hidden, which the dead man ends
const LEAVES = ["stop", "hold", "start"];
const AXES = [["surge", "Ahead", "astern"], ["sway", "Starboard", "port"], ["yaw", "Turn right", "left"]];
const $ = (name) => document.getElementById(`steer-${name}`);

export class Steering {
  /** desk: OrderDesk; connection; button: opens and closes it; chosen(): {boat, view, can}. */
  constructor({ desk, connection, button, chosen }) {
    Object.assign(this, { desk, connection, button, chosen, page: crypto.getRandomValues(new Uint32Array(4)).join("-").slice(0, 40) });
    this.open = false;
    this.boat = null; // that this page drives
    this.order = null; // number of the order that gave it, or false while it is not known
    this.lost = "";
    [this.pad, this.grip, this.touch] = [new Pad(), new Grip(), new TouchSticks($("grip"), $("stick"))];
    button.addEventListener("click", () => this.setOpen(!this.open));
    $("close").addEventListener("click", () => this.setOpen(false));
    $("take").addEventListener("click", () => (this.boat ? this.finish() : this.ask()));
    document.addEventListener("visibilitychange", () => document.hidden && this.letGo());
    for (const left of ["blur", "pagehide"]) globalThis.addEventListener(left, () => this.letGo());
  }

  setOpen(open) {
    if (open === this.open) return;
    if (!open && this.boat) this.finish();
    this.open = open;
    this.button.setAttribute("aria-pressed", String(open));
    $("box").hidden = !open;
    clearInterval(this.timer);
    if (open) this.timer = setInterval(() => this.step(), PERIOD_MS);
    if (open) $("box").scrollIntoView({ block: "nearest" });
    this.lost = "";
    this.step();
  }

  // --- whose the sticks are ------------------------------------------------------------------------

  ask() {
    const { boat } = this.chosen();
    this.desk.confirm("Drive by hand", `${boat} follows the sticks of this page while the dead man is held, and is in neutral without. It arms if it is not armed.`, () => this.take(boat));
  }

  async take(boat) {
    this.order = false;
    this.wanted = boat;
    this.waits = undefined;
    const given = await this.desk.give({ boat, command: "manual", page: this.page });
    this.waits = given.number ?? null;
    this.note({ number: null, ...given });
  }

  /** Word of an order, of this page or another: whether the sticks are given, or taken away. */
  note(given) {
    if (this.order === false && given.boat === this.wanted && given.number === this.waits && given.state !== "sending") {
      this.order = given.number;
      const yes = given.state === "answered" && given.outcome.status !== "refused";
      this.boat = yes && this.open ? given.boat : null;
      const refused = given.state === "answered";
      this.lost = yes ? "" : refused ? "The boat did not give this page the sticks." : "No answer from the boat: take the sticks again.";
      if (yes && !this.open) this.desk.stop([given.boat]); // closed before the answer
    } else if (this.boat && given.boat === this.boat && given.number > this.order && [...LEAVES, "manual"].includes(given.command)) {
      this.leave(`${given.command === "manual" ? "Another page has taken the sticks" : `${given.command} was given`}: this page drives no more.`);
    }
  }

  /** The console was started anew: it knows of no sticks that it gave, nor of any that were asked for. */
  restart() {
    if (this.boat || this.order === false) this.leave("The console was started anew: take the sticks again.");
    this.order = null;
  }

  leave(why) {
    this.letGo();
    this.boat = null;
    this.lost = why;
  }

  /** The end, in neutral, by the order that needs no question. */
  finish() {
    const { boat } = this;
    this.leave("");
    this.desk.stop([boat]);
  }

  // --- where they are ------------------------------------------------------------------------------

  /** Nobody holds them: said at once. */
  letGo() {
    this.touch.release();
    this.grip.pass(NOBODY);
    if (this.boat) this.send(NOBODY);
  }

  send(place) {
    this.connection.tellSticks({ page: this.page, boat: this.boat, t_ms: this.connection.console_ms(), ...place });
  }

  read() {
    const pad = this.pad.read(navigator.getGamepads?.() ?? [], performance.now());
    if (pad.stop && this.chosen().boat) this.desk.stopOrSayWhyNot();
    const { held, ahead, turn } = this.touch.read();
    const thumbs = { held, surge: shaped(ahead), sway: 0, yaw: shaped(turn) };
    const here = document.hasFocus() && !document.hidden;
    const { surge, sway, yaw } = held ? thumbs : pad;
    return { pad, place: this.grip.pass(here && (held || pad.held) ? { held: true, surge, sway, yaw } : NOBODY) };
  }

  step() {
    const { boat } = this.chosen();
    if (this.boat && this.boat !== boat) this.finish();
    if (!this.open) return;
    const { pad, place } = this.read();
    if (this.boat) this.send(place);
    this.show(pad, place);
  }

  // --- what is shown -------------------------------------------------------------------------------

  show(pad, place) {
    const { boat, can } = this.chosen();
    AXES.forEach(([axis, plus, minus], k) => {
      const row = $("shares").children[k];
      const share = place[axis];
      row.children[0].textContent = share < 0 ? `${plus.startsWith("Turn") ? "Turn " : ""}${minus}` : plus;
      row.children[1].value = Math.abs(share);
      row.children[2].textContent = figure(100 * Math.abs(share), 0, "%");
    });
    const text = this.words(pad, place);
    if ($("says").textContent !== text) $("says").textContent = text;
    $("box").dataset.kind = this.boat && place.held ? "held" : this.boat ? "mine" : "off";
    $("take").disabled = !this.boat && (!can || this.order === false);
    $("take").textContent = this.boat ? `Finish: STOP ${this.boat}` : `Take the sticks of ${boat ?? "the boat"}…`;
  }

  words(pad, place) {
    const with_ = pad.name ? `Gamepad: ${pad.name.replace(/\s*\(.*$/, "")}.` : pad.problem ? "" : "No gamepad yet: press one of its buttons; or use two thumbs.";
    if (this.order === false) return "Asking the boat…";
    if (!this.boat) return [this.lost, pad.problem, with_].filter(Boolean).join(" ");
    const mode = this.chosen().view?.mode;
    const why = mode && !["manual", "locked"].includes(mode.mode) ? `The boat is in ${mode.mode}: ${mode.why}.` : "";
    if (!this.connection.open) return "No connection to the console program: the boat is in neutral.";
    if (!place.held) return [why, pad.problem, "Neutral: hold a shoulder button of the gamepad, or “Hold to drive”."].filter(Boolean).join(" ");
    return why || (this.grip.waits || mode?.mode === "locked" ? `Neutral: let the sticks come to rest first.${mode?.mode === "locked" ? ` The boat waits: ${mode.why}.` : ""}` : `${this.boat} follows the sticks.`);
  }
}
