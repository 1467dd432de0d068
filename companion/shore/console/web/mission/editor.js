// Missions drawn on the map and beside it: one draft for each boat, for its places are in the axes of that boat's site.
// Nothing here moves a boat: a mission is sent by the order that a file is sent by, and asks first like that.

import { make } from "../panels.js";
import { figure } from "../words.js";
import { legs, problems } from "./checks.js";
import { MissionLayer } from "./layer.js";
import { MissionList } from "./list.js";
import { Plan, fileName, toToml } from "./plan.js";

const TYPES = "text/plain"; // of a file that is saved
const CHECK_MS = 250; // after the last change the console is asked what the boat's own checks say
const $ = (name) => document.getElementById(`mission-${name}`);

/** Problems of both, of each waypoint those that the boat's checks found, where they found any: they have the last word. */
function merged(own, judged) {
  const known = new Set(judged.map(({ at }) => at));
  return [...judged, ...own.filter(({ at, grave }) => !grave || !known.has(at))];
}

function minutes(seconds) {
  return seconds < 90 ? figure(seconds, 0, "s") : figure(seconds / 60, 1, "min");
}

export class MissionEditor {
  /** map: BoatMap; desk: OrderDesk; connection; button: opens and closes it; chosen(): {boat, view, can}, `can`: be given orders. */
  constructor({ map, desk, connection, button, chosen }) {
    Object.assign(this, { map, desk, connection, button, chosen, plans: new Map(), open: false, news: "", checked: null });
    this.pick = { at: (place) => this.edit((plan) => plan.add(place)), off: () => this.setOpen(false) };
    const remove = (k) => this.edit((plan) => plan.remove(k));
    const change = (k, parts) => this.edit((plan) => plan.change(k, parts));
    this.layer = new MissionLayer(map.map, { move: (...moved) => this.move(...moved), remove, insert: (k, place) => this.edit((plan) => plan.add(place, k)) });
    this.list = new MissionList($("list"), { change, remove });
    button.addEventListener("click", () => this.setOpen(!this.open));
    const does = {
      add: () => this.add(), undo: () => this.edit((plan) => plan.undo()), redo: () => this.edit((plan) => plan.redo()),
      clear: () => this.edit((plan) => plan.clear()), boat: () => this.takeBoats(), open: () => $("file").click(),
      save: () => this.save(), send: () => this.send(), close: () => this.setOpen(false),
    };
    for (const [name, act] of Object.entries(does)) $(name).addEventListener("click", act);
    $("file").addEventListener("change", () => this.read());
    $("name").addEventListener("change", ({ target }) => this.edit((plan) => plan.take({ ...plan.now, name: target.value })));
    $("box").addEventListener("keydown", (event) => this.key(event));
    map.element.addEventListener("keydown", (event) => this.key(event));
  }

  get plan() {
    const { boat } = this.chosen();
    if (!this.plans.has(boat)) this.plans.set(boat, new Plan());
    return this.plans.get(boat);
  }

  setOpen(open) {
    if (open === this.open) return;
    this.open = open;
    this.news = "";
    if (open) this.map.setPick(this.pick);
    else if (this.map.pick === this.pick) this.map.setPick(null);
    this.button.setAttribute("aria-pressed", String(open));
    $("box").hidden = !open;
    if (open) this.show();
    else this.layer.hide();
  }

  edit(change) {
    this.news = "";
    change(this.plan);
    this.show();
  }

  /** Ctrl+Z and Ctrl+Y (with Shift: Ctrl+Z), where the cursor is not in a field that has its own. */
  key(event) {
    if (!this.open || event.target.tagName === "INPUT" || !(event.ctrlKey || event.metaKey)) return;
    const key = event.key.toLowerCase();
    if (key !== "z" && key !== "y") return;
    event.preventDefault();
    this.edit((plan) => (key === "y" || event.shiftKey ? plan.redo() : plan.undo()));
  }

  move(k, [north_m, east_m], done) {
    if (done) return this.edit((plan) => plan.change(k, { north_m, east_m }));
    this.layer.line.setLatLngs(this.plan.waypoints.map((w, i) => (i === k ? [north_m, east_m] : [w.north_m, w.east_m])));
  }

  /** By keyboard: in the middle of the map, to be moved by its fields. */
  add() {
    const { lat, lng } = this.map.map.getCenter();
    this.edit((plan) => plan.add([lat, lng]));
    $("list").lastChild.querySelector("input").focus();
  }

  takeBoats() {
    const path = this.chosen().view?.path;
    if (!path) return this.say("The boat has reported no mission yet.");
    const end = path.end_heading_rad;
    this.edit((plan) => plan.take({ ...path, end_heading_deg: end === null ? null : (end * 180) / Math.PI }));
  }

  // --- files ---------------------------------------------------------------------------------------

  save() {
    const link = make("a");
    link.href = URL.createObjectURL(new Blob([this.text()], { type: TYPES }));
    link.download = fileName(this.plan.now);
    link.click();
    URL.revokeObjectURL(link.href);
  }

  /** A file, as the boat's loader reads it, which is asked of the console. */
  async read() {
    const [file] = $("file").files;
    if (!file) return;
    const about = this.chosen().view?.about;
    const placed = about && (about.lat_deg !== 0 || about.lon_deg !== 0);
    const origin = placed ? { lat_deg: about.lat_deg, lon_deg: about.lon_deg, rotation_deg: about.rotation_deg } : null;
    const { plan } = this;
    const told = await this.connection.post("/mission", { file: { name: file.name.slice(-100), text: await file.text() }, origin });
    $("file").value = "";
    const errors = told.errors ?? (told.why ? [told.why] : null);
    if (errors) return this.say(`${file.name} was not opened. ${errors.join(" ")}`);
    plan.take(told);
    this.news = "";
    this.show();
  }

  text() {
    return toToml(this.plan.now, this.chosen().view?.about?.site);
  }

  send() {
    const name = fileName(this.plan.now);
    this.desk.ask("load_mission", `takes “${name}” (${this.sum()}) as its mission, from the first waypoint at the next start.`, { name, text: this.text() });
  }

  // --- checked by the boat's own functions ---------------------------------------------------------

  /** What the console made of this very mission; null: it is not known yet, and asked for. */
  judged() {
    const key = `${this.chosen().boat} ${this.text()}`;
    if (this.checked?.key === key) return this.checked.told;
    if (this.asked !== key) {
      this.asked = key;
      clearTimeout(this.timer);
      this.timer = setTimeout(() => this.check(key), CHECK_MS);
    }
    return null;
  }

  async check(key) {
    const { boat } = this.chosen();
    const told = await this.connection.post("/mission/check", { boat, file: { name: fileName(this.plan.now), text: this.text() } });
    if (this.asked !== key) return;
    if (told.problems) this.checked = { key, told };
    else this.asked = null; // no answer: asked again with the next change
    if (told.problems) this.show();
  }

  // --- what is shown -------------------------------------------------------------------------------

  say(text) {
    this.news = text;
    this.show();
  }

  sum() {
    const { waypoints } = this.plan;
    const told = this.checked?.key === `${this.chosen().boat} ${this.text()}` ? this.checked.told : {};
    const metres = told.length_m || legs(waypoints).reduce((sum, leg) => sum + leg, 0);
    return `${waypoints.length} waypoint${waypoints.length === 1 ? "" : "s"}, ${figure(metres, 1, "m")}${told.duration_s ? `, about ${minutes(told.duration_s)}` : ""}`;
  }

  /** Called again and again: the boat, its fence and whether it can be given orders may change. */
  look() {
    if (!this.open) return;
    const { boat, view, can } = this.chosen();
    const key = `${boat} ${can} ${view?.about?.run}`;
    if (this.key_ !== key) this.show();
    this.key_ = key;
  }

  show() {
    const { boat, view, can } = this.chosen();
    if (!this.open) return;
    const { plan } = this;
    const own = problems(plan.now, view?.about);
    const judged = plan.waypoints.length && boat && !own.some(({ grave, at }) => grave && at === null) ? this.judged() : null;
    const found = judged ? merged(own, judged.problems) : own;
    const wrong = new Set(found.filter(({ grave }) => grave).map(({ at }) => at));
    this.layer.show(plan.waypoints, wrong, judged?.course);
    this.list.show(plan.waypoints, wrong);
    $("sum").textContent = this.sum() + (plan.now.fences.length ? `, fences of its file: ${plan.now.fences.length}` : "");
    if (document.activeElement !== $("name")) $("name").value = plan.now.name;
    $("undo").disabled = !plan.past.length;
    $("redo").disabled = !plan.future.length;
    $("clear").disabled = $("save").disabled = !plan.waypoints.length;
    $("send").disabled = wrong.size > 0 || !can;
    $("send").textContent = `Send to ${boat ?? "the boat"}…`;
    const told = [...(this.news ? [{ grave: true, text: this.news }] : []), ...found];
    const texts = told.map(({ text }) => text).join("\n");
    if ($("problems").dataset.shown === texts) return;
    $("problems").dataset.shown = texts;
    $("problems").replaceChildren(...told.map(({ grave, text }) => make("li", grave ? "grave" : "", text)));
  }
}
