// Numbers and states in words, the same on every page.

const MINUS = "−";
const NARROW = "\u202f";
export const NONE = "–";

/** A number with its unit, figures aligned; null: a dash. */
export function figure(value, digits, unit = "") {
  if (value === null || value === undefined || !Number.isFinite(value)) return NONE;
  const text = Math.abs(value).toFixed(digits);
  const sign = value < 0 && Number(text) !== 0 ? MINUS : "";
  return sign + text + (unit && NARROW + unit);
}

/** Heading [rad] as degrees from north, 000 to 359. */
export function heading(psi_rad) {
  if (psi_rad === undefined || psi_rad === null) return NONE;
  const degrees = Math.round(((psi_rad * 180) / Math.PI + 360) % 360) % 360;
  return `${String(degrees).padStart(3, "0")}°`;
}

/** How long ago, as short as a person says it. */
export function age(seconds) {
  if (seconds === null || !Number.isFinite(seconds)) return "never";
  if (seconds < 10) return `${Math.max(seconds, 0).toFixed(1)} s`;
  if (seconds < 100) return `${Math.round(seconds)} s`;
  if (seconds < 5400) return `${Math.round(seconds / 60)} min`;
  return `${Math.round(seconds / 3600)} h`;
}

export const MODES = {
  idle: ["Idle", "neutral"],
  starting: ["Starting", "waits"],
  auto: ["Mission", "drives"],
  hold: ["Holding", "drives"],
  excitation: ["Excitation", "drives"],
  paused: ["Paused", "waits"],
  locked: ["Sticks locked", "waits"],
  manual: ["By hand", "drives"],
  safe: ["Safe: neutral", "alarm"],
};

/** Mode of a boat: its word, and the kind that colours it. */
export function modeWords(mode) {
  if (mode?.ended) return ["Ended", "ended"];
  return mode ? (MODES[mode.mode] ?? [mode.mode, "waits"]) : ["Mode unknown", "unknown"];
}

/** How times of day are written: those of the person who looks, but for pages that say otherwise. */
export const clockOptions = {};

/** Time of day of an instant on the boat's clock, as the boat believes it; without the offset: seconds. */
export function clock(t_ns, unix_minus_t_ns) {
  if (!unix_minus_t_ns) return `${(t_ns * 1e-9).toFixed(1)} s`;
  return new Date((t_ns + unix_minus_t_ns) * 1e-6).toLocaleTimeString("en-GB", clockOptions);
}
