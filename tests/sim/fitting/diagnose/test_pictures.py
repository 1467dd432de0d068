"""Pictures of logs without inertial sensors, axes that hold all arrows, bars that say why nothing was named."""

import math
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.quiver import Quiver

from sim.fitting.diagnose.report import pictures
from sim.fitting.diagnose.report.sentences import gain_sentence, kept_sentence, size_text
from sim.fitting.diagnose.selection.held_out import MODELS, HeldOutScore, OpenLoopError
from sim.fitting.diagnose.selection.residual_forces import ResidualForces


def _residue(n: int = 200, seed: int = 3) -> ResidualForces:
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(n, 6))
    t = np.arange(float(n))
    return ResidualForces(t, t, np.zeros(n), x, rng.normal(size=(n, 3)), np.ones((n, 3)), rng.normal(size=(n, 3)))


def _error(
    gain_ci95: tuple[float, float], after: float, blocks: int = 10, ci95: tuple[float, float] = (0.9, 1.3)
) -> OpenLoopError:
    rms = {"base": 1.2, "refit": 1.0, "extended": after}
    return OpenLoopError(
        10, "position", "m", rms, dict.fromkeys(MODELS, ci95), 1 - after, gain_ci95, gain_ci95, 40, blocks
    )


def test_channels_without_data_have_no_picture():
    known, unknown = np.linspace(0.5, 0.0, 20), np.full(20, np.nan)
    figure = pictures.whiteness({"heading": known, "a_x": unknown}, {"heading": known, "a_x": unknown}, {"heading": 50})
    assert [ax.get_title() for ax in figure.axes] == ["heading"]
    bars = pictures.held_out([_error((0.1, 0.3), 0.8)])
    assert [ax.get_title() for ax in bars.axes] == ["position [m]"]


def test_no_arrow_leaves_its_axes():
    figure = pictures.over_basin(_residue(), _residue(seed=4))
    figure.draw_without_rendering()
    for ax in figure.axes:
        arrows = next(c for c in ax.collections if isinstance(c, Quiver))
        assert arrows.scale is not None
        tips = arrows.XY + np.column_stack([arrows.U, arrows.V]) / arrows.scale
        (west, east), (south, north) = ax.get_xlim(), ax.get_ylim()
        assert ((tips >= (west, south)) & (tips <= (east, north))).all()


def test_the_band_of_what_is_left_over_and_the_names_of_small_forces_are_in_the_picture():
    """Axes of 0.02 N were filled by a band of 2 N from edge to edge, as if nothing were certain of these lines."""
    left = replace(_residue(), force=0.005 * _residue().force)
    figure = pictures.over_time(left, left)
    assert all(low <= -2 and high >= 2 for low, high in (ax.get_ylim() for ax in figure.axes))
    small = replace(left, sigma=0.001 * left.sigma)
    speeds = {"u [m/s]": left.x[:, 3]}
    for drawn in (pictures.over_time(small, small), pictures.against(small, speeds)):
        drawn.draw_without_rendering()
        assert all(ax.yaxis.label.get_window_extent().x0 > 0 for ax in drawn.axes)


def test_one_row_of_axes_for_each_force():
    figure = pictures.against(_residue(), {"u [m/s]": _residue().x[:, 3], "v [m/s]": _residue().x[:, 4]})
    assert len(figure.axes) == 6
    assert [ax.get_xlabel() for ax in figure.axes[-2:]] == ["u [m/s]", "v [m/s]"]


def test_bars_beyond_the_line_say_their_size():
    figure = pictures.evidence({"lag": 80.0}, {"payload": (30.0, 0.4), "wash": (3.0, 0.2), "lag": (80.0, 2.0)}, 12.0)
    assert [text.get_text().strip() for text in figure.axes[0].texts] == ["named", "0.4", ""]


@pytest.mark.parametrize(
    ("ci95", "after", "said"),
    [((0.1, 0.3), 0.8, "cuts the 10 s position error on held-out data by 20 % (95 %: 10 to 30)"),
     ((-0.3, -0.1), 1.2, "raises the 10 s position error on held-out data by 20 % (95 %: 10 to 30)")],
)  # fmt: skip
def test_gain_is_said_with_its_sign(ci95: tuple[float, float], after: float, said: str):
    text = gain_sentence(HeldOutScore((_error(ci95, after),), {}, 10, ()), 1)
    assert said in text
    assert ("does not carry over" in text) == (after > 1)


def test_one_stretch_has_a_gain_but_no_interval_and_the_summary_says_so():
    alone = _error((-np.inf, 1.0), 0.8, blocks=1, ci95=(0.0, np.inf))
    text = gain_sentence(HeldOutScore((alone,), {}, 10, ()), 1)
    assert text.startswith("What was held out is too short to say what removing this error is worth: ")
    assert "is 1 m refitted and 0.8 m with the causes, in 40 windows of which 1 counts as independent" in text
    (ax,) = pictures.held_out([alone]).axes
    assert ax.get_ylim()[1] < 2.0


def test_numbers_without_a_unit():
    assert size_text(0.153, "1") == "15 %"
    assert size_text(0.153, "") == "0.15"


@pytest.mark.parametrize(
    ("refit", "gain", "ends"),
    [
        (0.2, (0.7, 0.9), "0.2 m instead of 1 m: use refitted.toml."),
        (0.2, (-math.inf, 1.0), "keep its file, or record more to be sure."),
        (0.95, (0.01, 0.1), "Keep its file."),
    ],
)
def test_where_nothing_is_wrong_the_better_file_is_named(refit, gain, ends):
    error = replace(_error((0.0, 0.0), refit), refit_gain_ci95=gain)
    error = replace(error, rms={**error.rms, "base": 1.0, "refit": refit})
    assert kept_sentence(HeldOutScore((error,), {}, 10, ())).endswith(ends)
