"""Heat map of pairwise evidence: which cause the logs could confuse with which."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure

from sim.fitting.diagnose.selection.candidate_score import DECISIVE_NATS
from sim.fitting.diagnose.selection.identifiability import PairwiseEvidence

MOST = 50.0
"""Nats beyond which a pair is not shown."""
EDGES = (0, 3, 6, DECISIVE_NATS, 20, 35, MOST)
SHADES = ("#67000d", "#cb181d", "#fc9272", "#c6dbef", "#6baed6", "#2171b5")
"""Reds below 12 nats, blues above."""
ROWS = 45
TELLING = 2.0  # nats by which a rival must be closer than "nothing" to have a column


def confusion(evidence: PairwiseEvidence) -> Figure | None:
    """Figure: rows true causes of medium size, columns rivals, "nothing" first, nats clipped at `MOST`.

    Rows are causes that the log shows with a rival below `MOST`; columns are rivals that are closer to some cause than
    "nothing". None where there are no such pairs.
    """
    grid = np.where((evidence.nothing >= DECISIVE_NATS)[:, None], np.nan_to_num(evidence.nats, nan=np.inf), np.inf)
    explains = (grid < MOST) & (grid < evidence.nothing[:, None] - TELLING)
    columns = np.flatnonzero(explains.any(axis=0))
    rows = np.flatnonzero((evidence.nothing >= DECISIVE_NATS) & ((evidence.nothing < MOST) | explains.any(axis=1)))
    if not len(rows):
        return None
    rows = rows[np.argsort(grid[rows].min(axis=1), kind="stable")][:ROWS]
    values = np.column_stack([evidence.nothing[rows], evidence.nats[np.ix_(rows, columns)]])
    figure = Figure(figsize=(0.34 * (len(columns) + 1) + 4.6, max(0.26 * len(rows) + 2.8, 4.2)), layout="constrained")
    ax = figure.add_subplot()
    colours = ListedColormap(SHADES, over="#f2f2f2", bad="white")
    drawn = ax.imshow(values, cmap=colours, norm=BoundaryNorm(EDGES, len(SHADES), clip=False), aspect="auto")
    drawn.set_clim(0, MOST)
    names = np.array(evidence.names)
    ax.set_xticks(range(len(columns) + 1), ["nothing", *names[columns]], rotation=45, ha="right", fontsize=8)
    ax.set_yticks(range(len(rows)), names[rows], fontsize=8)
    for i, j in np.argwhere(values < MOST):
        value = max(values[i, j], 0.0)
        dark = value < 6 or value >= 35
        ax.text(j, i, f"{value:.0f}", ha="center", va="center", fontsize=7, color="white" if dark else "black")
    ax.set(ylabel="true cause, medium size", xlabel="taken for")
    bar = figure.colorbar(drawn, ax=ax, ticks=EDGES, extend="max")
    bar.set_label("nats; red: cannot tell")
    return figure
