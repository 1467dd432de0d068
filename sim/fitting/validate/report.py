"""Self-contained HTML pages: header, contents, sentences, tables, pictures. No scripts, no links to elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from matplotlib.figure import Figure

from companion.core.configuration.vessel_file import VesselFile
from sim.fitting.validate.figures import comparison, error_growth, png_base64
from sim.fitting.validate.protocol import STEP_S
from sim.fitting.validate.scores import SPREAD, errors
from sim.fitting.validate.study import Validation
from sim.fitting.validate.table import ScoreTable, sentences, table

PAGES = Environment(
    loader=FileSystemLoader(Path(__file__).parent), autoescape=True, trim_blocks=True, undefined=StrictUndefined
)
PAGES.filters["png"] = png_base64


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


def report(
    validation: Validation,
    vessel: VesselFile,
    *,
    title: str,
    before: Sequence[Section] = (),
    after: Sequence[Section] = (),
) -> str:
    """Page of a validation alone: summary, sections `before` (fit, choices), scores, pictures, sections `after`."""
    summary = Section("What the held-out data says", tuple(sentences(validation)))
    return page(title, [summary, *before, every_figure(validation), pictures(validation, vessel), *after])


def page(title: str, sections: Sequence[Section], about: Sequence[tuple[str, str]] = ()) -> str:
    """The page as HTML text: a header with what it is `about` (name, value), contents, sections."""
    by = ("Written by", f"aritra {version('aritra')}")
    return PAGES.get_template("report.html.j2").render(title=title, sections=sections, about=(*about, by))


def every_figure(validation: Validation) -> Section:
    """Section with the table of all scores."""
    return Section("Every figure", tables=(table(validation),), note=NOTES)


def pictures(validation: Validation, vessel: VesselFile, model: int = 0) -> Section:
    """Section: measured against simulated motion in a window typical of model number `model`; growth of errors.

    `vessel`: by whose force maps commands are shown as forces.
    """
    window, name = typical_window(validation, model), validation.scores[model].name
    start_s = validation.windows.start_s[window]
    return Section(
        "Measured against simulated",
        (f"The window whose error under {name} is the median, from t = {start_s:.0f} s on.",),
        figures=(
            (
                comparison(validation, window, vessel),
                "Same commands, open loop; axes follow the measured run (Figures 7 to 10). Below: the pulses, and the "
                "steady forces that they make by the thrusters' maps.",
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


NOTES = (
    f"Bold: least of its row. NRMSE: rms over the range of the measured values. Ljung-Box p below 0.01: "
    f"residuals are not white. Diverged: outside {SPREAD:g} times the range of speeds in the training data, or "
    f"not finite. Commands are sampled every {1000 * STEP_S:.0f} ms."
)
