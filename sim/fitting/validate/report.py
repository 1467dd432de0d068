"""Self-contained HTML pages: sentences, tables, pictures. No scripts, no links, pictures inside."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from sim.fitting.validate.figures import comparison, error_growth, png_base64
from sim.fitting.validate.protocol import STEP_S
from sim.fitting.validate.scores import SPREAD, errors
from sim.fitting.validate.study import Validation
from sim.fitting.validate.table import ScoreTable, sentences, table

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 1100px; margin: 2em auto; padding: 0 1em; color: #222; }
h2 { margin-top: 2em; border-bottom: 2px solid #ddd; } .wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: 13px; } td, th { padding: 2px 10px; border-bottom: 1px solid #ddd; }
td { text-align: right; } td:first-child, th:first-child { text-align: left; } th { text-align: right; }
.text td, .text th { text-align: left; vertical-align: top; } thead th { position: sticky; top: 0; background: #fff; }
.look { background: #fff3cd; border-left: 4px solid #d55e00; padding: 0.2em 1em 0.2em 2em; }
figure { margin: 1em 0; } img { max-width: 100%; } figcaption { color: #555; font-size: 13px; }
pre { font-size: 12px; overflow-x: auto; }
@media print { body { max-width: none; } figure, tr { break-inside: avoid; } }
"""


@dataclass(frozen=True)
class Section:
    """A heading with sentences, tables, preformatted text, pictures with their captions, and a note below.

    `text`: the tables hold text, aligned left. `look`: the sentences are highlighted.
    """

    title: str
    sentences: tuple[str, ...] = ()
    preformatted: str = ""
    figures: tuple[tuple[Figure, str], ...] = ()
    tables: tuple[ScoreTable, ...] = ()
    note: str = ""
    text: bool = False
    look: bool = False


def report(validation: Validation, *, title: str, before: Sequence[Section] = (), after: Sequence[Section] = ()) -> str:
    """Page of a validation alone: summary, sections `before` (fit, choices), scores, pictures, sections `after`."""
    summary = Section("What the held-out data says", tuple(sentences(validation)))
    return page(title, [summary, *before, every_figure(validation), pictures(validation), *after])


def page(title: str, sections: Sequence[Section]) -> str:
    """The page as HTML text."""
    name = html.escape(title)
    body = "".join(_section(s) for s in sections)
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{name}</title>'
        f"<style>{STYLE}</style></head><body><h1>{name}</h1>{body}</body></html>\n"
    )


def every_figure(validation: Validation) -> Section:
    """Section with the table of all scores."""
    return Section("Every figure", tables=(table(validation),), note=NOTES)


def pictures(validation: Validation, model: int = 0) -> Section:
    """Section: measured against simulated motion in a window typical of model number `model`; growth of errors."""
    window, name = typical_window(validation, model), validation.scores[model].name
    start_s = validation.windows.start_s[window]
    return Section(
        "Measured against simulated",
        (f"The window whose error under {name} is the median, from t = {start_s:.0f} s on.",),
        figures=(
            (
                comparison(validation, window),
                "Same commands, open loop; axes follow the measured run (Figures 7 to 10).",
            ),
            (
                error_growth(validation),
                "Rms error over the horizon; dashed: baselines. Fewer runs reach far; no point: a run is gone.",
            ),
        ),
    )


def typical_window(validation: Validation, model: int = 0) -> int:
    """Index of the window, among the longest, whose largest position error under model number `model` is the median."""
    at = validation.windows.truth[..., 0]
    lasts = np.isfinite(at).sum(axis=1)
    full = np.flatnonzero(lasts == lasts.max())
    worst = np.nan_to_num(errors(validation.states[model], validation.windows.truth)[full, :, 0]).max(axis=1)
    return int(full[worst.argsort()[len(full) // 2]])


def _section(section: Section) -> str:
    """HTML of one section."""
    parts = [f"<h2>{html.escape(section.title)}</h2>"]
    if section.sentences:
        items = "".join(f"<li>{html.escape(s)}</li>" for s in section.sentences)
        parts.append(f'<ul class="look">{items}</ul>' if section.look else f"<ul>{items}</ul>")
    kind = "wide text" if section.text else "wide"
    parts += [f'<div class="{kind}">{one.html()}</div>' for one in section.tables]
    if section.note:
        parts.append(f"<p>{html.escape(section.note)}</p>")
    if section.preformatted:
        parts.append(f"<pre>{html.escape(section.preformatted)}</pre>")
    for figure, caption in section.figures:
        text = html.escape(caption)
        parts.append(
            f'<figure><img alt="{text}" src="data:image/png;base64,{png_base64(figure)}">'
            f"<figcaption>{text}</figcaption></figure>"
        )
    return "".join(parts)


NOTES = (
    f"Bold: least of its row. NRMSE: rms over the range of the measured values. Ljung-Box p below 0.01: "
    f"residuals are not white. Diverged: outside {SPREAD:g} times the range of speeds in the training data, or "
    f"not finite. Commands are sampled every {1000 * STEP_S:.0f} ms."
)
