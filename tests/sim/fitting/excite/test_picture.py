"""The picture of a flight: whatever its segments are called, no legend leaves it or covers what was flown."""

import numpy as np
from matplotlib.figure import Figure

from companion.boat.load_run import EXAMPLES
from companion.core.configuration.site_file import load_site
from companion.core.excitation.file import load_excitation
from companion.core.excitation.pen import Pen
from sim.fitting.excite.picture import FlightTrace, draw_flight


def test_no_legend_leaves_the_picture_or_covers_data(tmp_path, monkeypatch):
    made = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_args, **_more: made.append(figure))
    plan = load_excitation((EXAMPLES / "excitations" / "library.toml").read_text(encoding="utf-8"), name="library")
    site = load_site((EXAMPLES / "sites" / "basin.toml").read_text(encoding="utf-8"), name="basin")
    n = len(plan.segments)
    flight = FlightTrace(np.arange(float(n)), np.ones((n, 6)), np.arange(n), np.ones((n, 4)))
    names = ["front_port", "front_starboard", "rear_port", "rear_starboard"]
    draw_flight(flight, plan, Pen(site), names, "all of it", tmp_path / "picture.png")
    (figure,) = made
    figure.draw_without_rendering()
    legends = [*figure.legends, *(ax.get_legend() for ax in figure.axes if ax.get_legend())]
    assert len(legends) == 4
    for box in (legend.get_window_extent() for legend in legends):
        assert figure.bbox.x0 <= box.x0 and box.x1 <= figure.bbox.x1 and figure.bbox.y0 <= box.y0, box
        assert not any(box.padded(-2).overlaps(ax.bbox) for ax in figure.axes), box
