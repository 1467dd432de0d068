// Alarms that sound and notify, once somebody has switched them on: browsers let no page make a noise without a gesture.
// Tones are made here (Web Audio); a notification is shown where the browser allows it. Silent until then.

const AGAIN_MS = 1500; // between two sounds
const TONES = { error: [880, 660, 880, 660], warning: [660] };
const TONE_S = 0.16;
const NEW_S = 5; // an alert older than that came with the history

export class Alarms {
  /** button: switches them on and off. */
  constructor(button) {
    this.button = button;
    this.context = null;
    this.sounded_ms = -Infinity;
    this.sounded = "";
    this.standing = new Map(); // what lasts, so that it is told once: key -> text
    button.addEventListener("click", () => (this.context ? this.off() : this.on()));
    this.show();
  }

  on() {
    this.context = new AudioContext();
    this.show();
    for (const text of this.standing.values()) this.raise("error", text);
    this.sound("warning"); // where nothing stands: so that one hears what it will be like
    globalThis.Notification?.requestPermission?.();
  }

  off() {
    this.context.close();
    this.context = null;
    this.show();
  }

  show() {
    this.button.textContent = this.context ? "Alarms on" : "Alarms off";
    this.button.setAttribute("aria-pressed", String(Boolean(this.context)));
  }

  /** A boat's alert, `old_s` seconds old. */
  alert(boat, { level, text }, old_s) {
    if (level !== "info" && old_s <= NEW_S) this.raise(level, `${boat}: ${text}`);
  }

  /** Something that lasts: told when it begins. `text`: null where it is not so. */
  stands(key, level, text) {
    if (text && !this.standing.has(key)) this.raise(level, text);
    if (text) this.standing.set(key, text);
    else this.standing.delete(key);
  }

  raise(level, text) {
    if (!this.context) return;
    this.sound(level);
    try {
      if (globalThis.Notification?.permission === "granted") new Notification("Aritra", { body: text, tag: text });
    } catch {
      // some phones allow notifications only to installed pages
    }
  }

  sound(level) {
    const now_ms = performance.now();
    if (now_ms - this.sounded_ms < AGAIN_MS && (level !== "error" || this.sounded === "error")) return;
    [this.sounded_ms, this.sounded] = [now_ms, level];
    this.context.resume(); // a phone that was locked suspends it
    TONES[level].forEach((pitch, k) => this.tone(pitch, this.context.currentTime + k * TONE_S));
  }

  tone(pitch, at_s) {
    const [source, gain] = [this.context.createOscillator(), this.context.createGain()];
    source.frequency.value = pitch;
    gain.gain.setValueAtTime(0.3, at_s);
    gain.gain.exponentialRampToValueAtTime(0.001, at_s + TONE_S); // no click at the end
    source.connect(gain).connect(this.context.destination);
    source.start(at_s);
    source.stop(at_s + TONE_S);
  }
}
