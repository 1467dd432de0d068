// From sticks to shares of the thrusters' force, by the rules of `aritra teleop` (drivers/sticks). Pure: no DOM.

const AT_REST = 0.05; // below it is a stick that nobody holds
const DEAD_ZONE = 0.12;
const EXPO = 0.4;
const FROZEN_MS = 10000; // a pad that is off its middle and has not moved at all for so long has lost its radio
const GRIPS = [4, 5]; // shoulder buttons: the dead man
const STOP = 0; // the first button: A, or the cross

export const NOBODY = { held: false, surge: 0, sway: 0, yaw: 0 };

/** sign(v) ((1 - e) s + e s^3), s = max(0, (|v| - z) / (1 - z)): drivers/sticks/mapping. */
export function shaped(value) {
  if (!Number.isFinite(value)) return 0;
  const size = Math.min(Math.max(0, (Math.abs(value) - DEAD_ZONE) / (1 - DEAD_ZONE)), 1);
  return Math.sign(value) * ((1 - EXPO) * size + EXPO * size ** 3);
}

/** Sticks count once they have been at rest since the dead man was pressed: pressing it moves nothing by itself. */
export class Grip {
  constructor() {
    this.rested = false;
  }

  pass({ held, surge, sway, yaw }) {
    if (!held) {
      this.rested = false;
      return NOBODY;
    }
    if (Math.max(...[surge, sway, yaw].map(Math.abs)) < AT_REST) this.rested = true;
    return this.rested ? { held, surge, sway, yaw } : { ...NOBODY, held };
  }

  get waits() {
    return !this.rested;
  }
}

/** One gamepad of the browser's, of those that it knows the layout of. */
export class Pad {
  constructor() {
    this.moved_ms = 0;
    this.stamp = null;
    this.stopped = true; // a button that is down when the pad appears is not pressed
  }

  /** pads: navigator.getGamepads(). {name, problem, stop, held, surge, sway, yaw}; `stop`: its button went down. */
  read(pads, now_ms) {
    const there = [...pads].filter((pad) => pad?.connected);
    const pad = there.find(({ mapping }) => mapping === "standard");
    if (!pad) {
      this.stamp = null;
      this.stopped = true;
      return { ...NOBODY, name: "", stop: false, problem: there.length ? "The browser does not know the layout of this gamepad." : "" };
    }
    const places = [pad.axes[0], pad.axes[1], pad.axes[2]];
    const stamp = `${pad.index} ${pad.timestamp} ${places}`;
    if (stamp !== this.stamp) this.moved_ms = now_ms;
    this.stamp = stamp;
    const down = Boolean(pad.buttons[STOP]?.pressed);
    const stop = down && !this.stopped;
    this.stopped = down;
    const [sway, surge, yaw] = [shaped(places[0]), -shaped(places[1]), shaped(places[2])];
    const off = Math.max(...[surge, sway, yaw].map(Math.abs)) >= AT_REST;
    const frozen = off && now_ms - this.moved_ms > FROZEN_MS;
    const held = !frozen && GRIPS.some((k) => pad.buttons[k]?.pressed);
    return { name: pad.id, problem: frozen ? "The gamepad stands still: is its radio there?" : "", stop, held, surge, sway, yaw };
  }
}
