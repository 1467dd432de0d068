// The fence, drawn anew for a site file. No boat takes it while its program runs, and the page says so: it is a file for
// the next run. The console reads and checks it by the boat's own loader, and keeps everything else of the file.

import { make } from "../panels.js";
import { MissionLayer } from "./layer.js";

const CHECK_MS = 250;
const MM = 1000;
const TYPES = "text/plain";
const $ = (name) => document.getElementById(`fence-${name}`);
const round = (place) => place.map((value) => Math.round(value * MM) / MM);

class FenceLayer extends MissionLayer {
  showCorners(corners) {
    this.show(corners.map(([north_m, east_m]) => ({ north_m, east_m })));
    this.line.setLatLngs(corners.length ? [...corners, corners[0]] : []);
  }
}

export class FenceEditor {
  /** map: BoatMap; connection; button: opens and closes it. */
  constructor({ map, connection, button }) {
    Object.assign(this, { map, connection, button, open: false, file: null, corners: [], past: [] });
    this.pick = { at: (place) => this.file && this.edit(this.corners.concat([place])), off: () => this.setOpen(false) };
    this.layer = new FenceLayer(map.map, {
      move: (k, place, done) => (done ? this.edit(this.corners.with(k, place)) : this.layer.line.setLatLngs([...this.corners.with(k, place), this.corners.with(k, place)[0]])),
      remove: (k) => this.edit(this.corners.toSpliced(k, 1)),
      insert: (k, place) => this.edit(this.corners.toSpliced(k, 0, place)),
    });
    button.addEventListener("click", () => this.setOpen(!this.open));
    $("close").addEventListener("click", () => this.setOpen(false));
    $("open").addEventListener("click", () => $("file").click());
    $("file").addEventListener("change", () => this.read());
    $("undo").addEventListener("click", () => this.undo());
    $("save").addEventListener("click", () => this.save());
  }

  setOpen(open) {
    if (open === this.open) return;
    this.open = open;
    if (open) this.map.setPick(this.pick);
    else if (this.map.pick === this.pick) this.map.setPick(null);
    this.button.setAttribute("aria-pressed", String(open));
    $("box").hidden = !open;
    if (open) this.show();
    else this.layer.hide();
  }

  async read() {
    const [chosen] = $("file").files;
    if (!chosen) return;
    const file = { name: chosen.name.slice(-100), text: await chosen.text() };
    $("file").value = "";
    const told = await this.connection.post("/site", file);
    if (!told.fence) return this.say(`${chosen.name} was not opened. ${(told.errors ?? [told.why]).join(" ")}`, true);
    Object.assign(this, { file, site: told.site, corners: told.fence, past: [], told });
    this.show();
  }

  edit(corners) {
    this.past.push(this.corners);
    this.corners = corners.map(round);
    this.look();
  }

  undo() {
    this.corners = this.past.pop() ?? this.corners;
    this.look();
  }

  /** Ask the console for the file with this fence, a moment after the last change. */
  look() {
    this.told = null;
    clearTimeout(this.timer);
    const { corners } = this;
    this.timer = setTimeout(async () => {
      const told = await this.connection.post("/site", { ...this.file, fence: corners });
      if (this.corners !== corners) return;
      this.told = told.fence || told.errors ? told : { errors: [told.why] };
      this.show();
    }, CHECK_MS);
    this.show();
  }

  save() {
    const link = make("a");
    link.href = URL.createObjectURL(new Blob([this.told.text], { type: TYPES }));
    link.download = this.file.name;
    link.click();
    URL.revokeObjectURL(link.href);
  }

  say(text, grave = false) {
    if ($("says").textContent !== text) $("says").textContent = text;
    $("says").classList.toggle("grave", grave);
  }

  show() {
    if (!this.open) return;
    this.layer.showCorners(this.corners);
    $("undo").disabled = !this.past.length;
    $("save").disabled = !this.told?.text;
    if (!this.file) return this.say("Open the site file whose fence is to be another.");
    if (this.told?.errors) return this.say(this.told.errors.join(" "), true);
    this.say(`${this.file.name}, site ${this.site}: ${this.corners.length} corners. ${this.told ? "It can be saved." : "Checking…"}`);
  }
}
