"""Pictures of the report on an identification that a validation alone does not have."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from companion.core.configuration.vessel_file import VesselFile
from sim.fitting.engine.parameters import file_values
from sim.fitting.identify.plausible import bands
from sim.fitting.identify.result import FitResult
from sim.fitting.identify.structured_fit import FitSettings
from sim.fitting.validate.figures import COLOURS, INK

FINE = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1, 1.1, 1.2, 1.3, 1.5, 1.7, 2, 2.5, 3)
COARSE = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100)


def parameters(result: FitResult, base: VesselFile, settings: FitSettings) -> Figure:
    """Every parameter that cannot change its sign over the base file's value, with its 95 % interval."""
    keeps_sign = settings.parameters(base).is_positive()
    before = file_values(base, settings.surroundings, settings.unmeasured_imu)
    triples = zip(result.parameters, before, keeps_sign, strict=True)
    shown = [(p, believed) for p, believed, keeps in triples if keeps and believed]
    figure = Figure(figsize=(9, 0.28 * len(shown) + 1.2), layout="constrained")
    ax = figure.add_subplot()
    at = np.arange(len(shown))[::-1]
    ax.axvline(1.0, color=INK, lw=1, label="base file")
    for determined, colour, label in ((True, COLOURS[0], "determined"), (False, COLOURS[1], "not determined")):
        mine = [(y, p, b) for y, (p, b) in zip(at, shown, strict=True) if p.determined == determined]
        if not mine:
            continue
        value = np.array([p.value / b for _, p, b in mine])
        ends = np.sort([[c / b for c in p.ci95] for _, p, b in mine], axis=1)
        spread = np.maximum(np.abs(ends.T - value), 0.0)
        ax.errorbar(value, [y for y, _, _ in mine], xerr=spread, fmt="o", ms=4, color=colour, capsize=3, label=label)
    ax.set_yticks(at, [p.name for p, _ in shown], fontsize=8)
    ax.set(xlabel="identified value over the base file's, 95 % interval", xscale="log", ylim=(-0.7, len(shown) - 0.3))
    low, high = ax.get_xlim()
    allowed = bands(base)
    boxes = [
        (y, *sorted(end / b for end in allowed[p.name]))
        for y, (p, b) in zip(at, shown, strict=True)
        if p.name in allowed
    ]
    if boxes:
        y, least, most = np.array(boxes).T
        ax.barh(y, most - least, left=least, height=0.8, color="#e4e4e4", zorder=0, label="such a hull")
    low, high = min(low, 0.4), max(high, 2.5)
    ax.set_xlim(low, high)
    ticks = [t for t in (FINE if high < 4 * low else COARSE) if low <= t <= high]
    ax.set_xticks(ticks, [f"{t:g}" for t in ticks])
    ax.minorticks_off()
    ax.grid(axis="x", alpha=0.3)
    figure.legend(*ax.get_legend_handles_labels(), loc="outside upper center", ncols=4, fontsize=8)
    return figure
