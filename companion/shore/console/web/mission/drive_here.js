// "Drive here": a click on the map, a question like that of Start, and then a mission of this one point, and its start.

import { placed } from "../shapes.js";
import { figure } from "../words.js";
import { clearance, leaves } from "./checks.js";
import { Plan, toToml } from "./plan.js";

const L = globalThis.L;
const NAME = "there";

export class DriveHere {
  /** map: BoatMap; desk: OrderDesk; button; note: says what to do; chosen(): {boat, view, can}. */
  constructor({ map, desk, button, note, chosen }) {
    Object.assign(this, { map, desk, button, note, chosen });
    this.pick = { at: (place) => this.take(place), off: () => this.end() };
    document.addEventListener("keydown", ({ key }) => key === "Escape" && map.pick === this.pick && map.setPick(null));
    button.addEventListener("click", () => (map.pick === this.pick ? map.setPick(null) : this.begin()));
  }

  begin() {
    this.map.setPick(this.pick);
    this.button.setAttribute("aria-pressed", "true");
    this.say(`Click where ${this.chosen().boat} is to go; it asks before it drives.`);
  }

  end() {
    this.button.setAttribute("aria-pressed", "false");
    this.say("");
  }

  say(text) {
    this.note.hidden = !text;
    this.note.textContent = text;
  }

  /** Called again and again. */
  look() {
    const { can } = this.chosen();
    this.button.disabled = !can;
    if (!can && this.map.pick === this.pick) this.map.setPick(null);
  }

  take(place) {
    const { boat, view } = this.chosen();
    const { about, mode } = view;
    if (!about) return this.say(`${boat} has not reported its fence yet.`);
    const plan = new Plan();
    plan.take({ name: NAME, waypoints: [{ north_m: place[0], east_m: place[1] }] });
    const { north_m, east_m } = plan.waypoints[0];
    const room = clearance(about, [north_m, east_m]);
    if (room < 0) return this.say(`That place lies ${figure(-room, 1, "m")} beyond the fence: choose another.`);
    this.map.setPick(null);
    const target = L.marker(place, { interactive: false, keyboard: false, icon: L.divIcon({ className: "target", iconSize: [30, 30] }) }).addTo(this.map.map);
    const leave = mode?.mode === "auto" || mode?.mode === "starting";
    const mission = { name: `${NAME}.toml`, text: toToml(plan.now, about.site) };
    this.desk.confirm("Drive here", `${boat} ${words([north_m, east_m], view, leave)}`, () => this.desk.driveThere(boat, mission, leave), () => target.remove());
  }
}

/** What the boat will do. */
function words([north_m, east_m], { about, state }, leave) {
  const at = placed(state) && [state.north_m, state.east_m];
  return [
    `goes to ${figure(north_m, 1, "m")} N, ${figure(east_m, 1, "m")} E`,
    at ? `, ${figure(Math.hypot(north_m - at[0], east_m - at[1]), 1, "m")} from here` : "",
    ", and keeps station there. ",
    leave ? "It leaves the mission that it drives. " : "",
    at && leaves(about, at, [north_m, east_m]) ? "The straight way there leaves the fence. " : "",
    "It arms if it is not armed.",
  ].join("");
}
