// The list of boats: one button each to look at it closely, and one to put away what has ended or cannot be reached.

import { make } from "./panels.js";

export class BoatList {
  /** choose(name), putAway(name): what its buttons do. */
  constructor(element, { choose, putAway }) {
    Object.assign(this, { element, choose, putAway });
  }

  /** about(name): {name, word, kind, programs, old, chosen, gone}. Elements stay, so that focus and screen readers are left in peace. */
  show(names, about) {
    names.forEach((name, k) => this.fill(this.element.children[k] ?? this.add(), about(name)));
    while (this.element.children.length > names.length) this.element.lastChild.remove();
  }

  add() {
    const item = this.element.appendChild(make("li"));
    const button = make("button", "boat");
    button.append(make("b"), make("span", "boat-mode"), make("span", "boat-age"));
    button.addEventListener("click", () => this.choose(button.dataset.boat));
    const away = make("button", "away", "×");
    away.addEventListener("click", () => this.putAway(button.dataset.boat));
    item.append(button, away);
    return item;
  }

  fill(item, { name, word, kind, programs, old, chosen, gone }) {
    const [button, away] = item.children;
    [programs > 1 ? `${name} ×${programs}` : name, word, old].forEach((text, i) => {
      if (button.children[i].textContent !== text) button.children[i].textContent = text;
    });
    button.dataset.boat = name;
    button.dataset.kind = kind;
    button.setAttribute("aria-pressed", String(chosen));
    away.hidden = !gone;
    away.title = `Put ${name} away until it speaks again`;
    away.setAttribute("aria-label", away.title);
  }
}
