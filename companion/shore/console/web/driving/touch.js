// Two thumbs on the screen, or the keyboard: one holds the dead man, the other moves the stick.

const KEY_SHARE = 0.5;
const KEYS = { ArrowUp: [1, 0], ArrowDown: [-1, 0], ArrowRight: [0, 1], ArrowLeft: [0, -1] };

export class TouchSticks {
  /** grip: the button that must be held; stick: the area on which the other thumb moves `knob`. */
  constructor(grip, stick) {
    Object.assign(this, { grip, stick, knob: stick.firstElementChild, down: new Set() });
    this.release();
    const hold = (held) => (event) => {
      event.preventDefault();
      this.thumb = held;
    };
    grip.addEventListener("pointerdown", (event) => {
      grip.setPointerCapture(event.pointerId);
      hold(true)(event);
    });
    for (const over of ["pointerup", "pointercancel", "lostpointercapture"]) grip.addEventListener(over, hold(false));
    grip.addEventListener("contextmenu", (event) => event.preventDefault());
    stick.addEventListener("pointerdown", (event) => {
      stick.setPointerCapture(event.pointerId);
      this.move(event);
    });
    stick.addEventListener("pointermove", (event) => stick.hasPointerCapture(event.pointerId) && this.move(event));
    for (const over of ["pointerup", "pointercancel", "lostpointercapture"]) stick.addEventListener(over, () => this.centre());
    stick.addEventListener("keydown", (event) => this.key(event, true));
    stick.addEventListener("keyup", (event) => this.key(event, false));
    stick.addEventListener("blur", () => this.down.clear());
  }

  /** Nobody touches anything: the page was left. */
  release() {
    this.thumb = false;
    this.down.clear();
    this.centre();
  }

  centre() {
    [this.ahead, this.turn] = [0, 0];
    this.knob.style.translate = "0 0";
  }

  move(event) {
    event.preventDefault();
    const box = this.stick.getBoundingClientRect();
    const reach = Math.min(box.width, box.height) / 2;
    const within = (value) => Math.max(-1, Math.min(1, value / reach));
    this.turn = within(event.clientX - (box.left + box.width / 2));
    this.ahead = -within(event.clientY - (box.top + box.height / 2));
    this.knob.style.translate = `${this.turn * reach * 0.8}px ${-this.ahead * reach * 0.8}px`;
  }

  /** Shift holds, arrows move, while the stick has the focus. */
  key(event, isDown) {
    if (event.key !== "Shift" && !KEYS[event.key]) return;
    event.preventDefault();
    if (isDown) this.down.add(event.key);
    else this.down.delete(event.key);
  }

  /** {held, ahead, turn}, -1 to 1, as the thumbs are now. */
  read() {
    const arrows = [...this.down].filter((key) => KEYS[key]);
    const sum = (axis) => KEY_SHARE * arrows.reduce((total, key) => total + KEYS[key][axis], 0);
    return { held: this.thumb || this.down.has("Shift"), ahead: this.ahead || sum(0), turn: this.turn || sum(1) };
  }
}
