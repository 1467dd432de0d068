"""What a person sees of the console at each size of screen: boxes that lie on each other, and where STOP is."""

from __future__ import annotations

from typing import NamedTuple

SIZES = {390: 844, 820: 1180, 1440: 900}
"""Width of a phone, a tablet, a laptop -> its height [px]."""
THEMES = ("light", "dark")
BOXES = (
    "header, #link, #mode, #orders, #orders button, #question, #answers, .no-boat, main nav, main section, "
    "main h2, .boat, .map-buttons button, #map-box > p, #figures div, #links div, #thrusters li, .plot, "
    "#attitude, #checks"
)
OVERLAPS = """(selector) => {
  const clipped = (element) => {
    let { left, top, right, bottom } = element.getBoundingClientRect();
    for (let p = element.parentElement; p && p !== document.body; p = p.parentElement) {
      if (getComputedStyle(p).overflow === "visible") continue;
      const box = p.getBoundingClientRect();
      [left, top] = [Math.max(left, box.left), Math.max(top, box.top)];
      [right, bottom] = [Math.min(right, box.right), Math.min(bottom, box.bottom)];
    }
    return { left, top, right, bottom };
  };
  const name = (e) => e.id || e.className || `${e.parentElement.id} ${e.tagName}`;
  const seen = [...document.querySelectorAll(selector)].filter((e) => e.checkVisibility())
    .map((e) => [e, clipped(e)]).filter(([, r]) => r.right - r.left > 1 && r.bottom - r.top > 1);
  const found = [];
  seen.forEach(([a, p], k) => {
    for (const [b, q] of seen.slice(k + 1)) {
      if (a.contains(b) || b.contains(a)) continue;
      const wide = Math.min(p.right, q.right) - Math.max(p.left, q.left);
      const high = Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top);
      if (wide > 1 && high > 1) found.push(`${name(a)} x ${name(b)}: ${Math.round(wide)} x ${Math.round(high)} px`);
    }
  });
  return found;
}"""
"""Pairs of boxes, neither inside the other, that share more than a pixel of what is visible of them."""


class Place(NamedTuple):
    """Where an element is on the screen [px]."""

    x: float
    y: float
    width: float
    height: float


def overlaps(page) -> list[str]:
    """Boxes of the page that lie on each other, in words."""
    return page.page.evaluate(OVERLAPS, BOXES)


def place(page, selector: str) -> Place:
    """Where an element is; raises where it is not on the screen."""
    box = page.page.locator(selector).bounding_box()
    assert box is not None, f"{selector} is not shown"
    return Place(box["x"], box["y"], box["width"], box["height"])


def reachable(page, selector: str) -> bool:
    """Whether a click in the middle of an element hits it, and it is on the screen whole."""
    return page.page.evaluate(
        """(s) => { const e = document.querySelector(s), r = e.getBoundingClientRect();
        const inside = r.left >= 0 && r.top >= 0 && r.right <= innerWidth && r.bottom <= innerHeight;
        return inside && e.contains(document.elementFromPoint((r.left + r.right) / 2, (r.top + r.bottom) / 2)); }""",
        selector,
    )


def resize(page, width: int, theme: str) -> None:
    """Another screen, and another theme of the system."""
    page.page.set_viewport_size({"width": width, "height": SIZES[width]})
    page.page.emulate_media(color_scheme=theme)
    page.page.wait_for_timeout(400)  # plots and map are drawn anew


def scroll(page, share: float) -> None:
    """Scroll the page, and whatever scrolls in its place, to a share of its length."""
    page.page.evaluate(
        """(share) => { for (const e of [document.scrollingElement, document.querySelector('main')])
        e.scrollTop = share * (e.scrollHeight - e.clientHeight); }""",
        share,
    )
    page.page.wait_for_timeout(50)
