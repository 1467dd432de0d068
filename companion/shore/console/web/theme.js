// Light or dark: as the system says, or as the page's switch does, which the browser remembers. Elements and the map take
// their colours from theme.css by themselves; who paints on a canvas asks `ink`, and again after `onTheme`.

const KEY = "aritra-theme";
const THEMES = ["system", "light", "dark"];
const root = document.documentElement;
const probe = document.createElement("i");
const known = new Map();
const listeners = [];

/** The colour --name of the theme of now, as a canvas takes it. */
export function ink(name) {
  if (!known.has(name)) {
    if (!probe.isConnected) document.body.append(Object.assign(probe, { hidden: true }));
    probe.style.color = `var(--${name})`;
    known.set(name, getComputedStyle(probe).color);
  }
  return known.get(name);
}

/** Call `paint` whenever colours have changed. */
export function onTheme(paint) {
  listeners.push(paint);
}

function changed() {
  known.clear();
  for (const paint of listeners) paint();
}

matchMedia("(prefers-color-scheme: dark)").addEventListener("change", changed);

function remembered() {
  try {
    return localStorage.getItem(KEY);
  } catch {
    return null; // a browser that keeps nothing
  }
}

/** Let a <select> of system, light, dark say which, and remember it. */
export function themeSwitch(select) {
  const show = (theme) => {
    if (theme === "system") delete root.dataset.theme;
    else root.dataset.theme = theme;
    changed();
  };
  select.value = THEMES.includes(remembered()) ? remembered() : "system";
  show(select.value);
  select.addEventListener("change", () => {
    try {
      localStorage.setItem(KEY, select.value);
    } catch {
      // shown, and not remembered
    }
    show(select.value);
  });
}
