"""One self-contained HTML page: sentences, table, pictures. No scripts, no links, pictures inside."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from sim.identify.validation.figures import comparison, error_growth, png_base64
from sim.identify.validation.protocol import STEP_S
from sim.identify.validation.scores import SPREAD, errors
from sim.identify.validation.study import Validation
from sim.identify.validation.table import sentences, table

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 1100px; margin: 2em auto; padding: 0 1em; color: #222; }
table { border-collapse: collapse; font-size: 13px; } td, th { padding: 2px 10px; border-bottom: 1px solid #ddd; }
td { text-align: right; } td:first-child, th:first-child { text-align: left; } th { text-align: right; }
img { max-width: 100%; } figcaption { color: #555; font-size: 13px; } pre { font-size: 12px; overflow-x: auto; }
"""


@dataclass(frozen=True)
class Section:
    """More for the page: a heading, sentences, preformatted text or pictures with their captions."""

    title: str
    sentences: tuple[str, ...] = ()
    preformatted: str = ""
    figures: tuple[tuple[Figure, str], ...] = ()


def report(found: Validation, *, title: str, before: Sequence[Section] = (), after: Sequence[Section] = ()) -> str:
    """The page. `before` (what was fitted, on what, with which choices) stands after the summary."""
    summary = Section("What the held-out data says", tuple(sentences(found)))
    window = typical_window(found)
    pictures = Section(
        "Measured against simulated",
        (f"The window whose error is the median one, from t = {found.windows.start_s[window]:.0f} s of its log on.",),
        figures=(
            (comparison(found, window), "Same commands, open loop; axes follow the measured run (Figures 7 to 10)."),
            (error_growth(found), "Rms error over the horizon; dashed: baselines. A line ends where runs are gone."),
        ),
    )
    sections = "".join(_section(s) for s in (summary, *before))
    sections += f"<h2>Every figure</h2>{table(found).html()}{_notes()}"
    sections += "".join(_section(s) for s in (pictures, *after))
    name = html.escape(title)
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{name}</title>'
        f"<style>{STYLE}</style></head><body><h1>{name}</h1>{sections}</body></html>\n"
    )


def typical_window(found: Validation) -> int:
    """Of the longest windows, the one whose position error under the first model is the median."""
    at = found.windows.truth[..., 0]
    lasts = np.isfinite(at).sum(axis=1)
    full = np.flatnonzero(lasts == lasts.max())
    worst = np.nan_to_num(errors(found.states[0], found.windows.truth)[full, :, 0]).max(axis=1)
    return int(full[worst.argsort()[len(full) // 2]])


def _section(section: Section) -> str:
    parts = [f"<h2>{html.escape(section.title)}</h2>"]
    if section.sentences:
        parts.append("<ul>" + "".join(f"<li>{html.escape(s)}</li>" for s in section.sentences) + "</ul>")
    if section.preformatted:
        parts.append(f"<pre>{html.escape(section.preformatted)}</pre>")
    for figure, caption in section.figures:
        text = html.escape(caption)
        parts.append(
            f'<figure><img alt="{text}" src="data:image/png;base64,{png_base64(figure)}">'
            f"<figcaption>{text}</figcaption></figure>"
        )
    return "".join(parts)


def _notes() -> str:
    return (
        f"<p>Bold: least of its row. NRMSE: rms over the range of the measured values. Ljung-Box p below 0.01: "
        f"residuals are not white. Diverged: outside {SPREAD:g} times the range of speeds in the training data, or "
        f"not finite. Commands are sampled every {1000 * STEP_S:.0f} ms.</p>"
    )
