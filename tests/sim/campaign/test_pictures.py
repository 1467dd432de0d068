"""Pictures of figures that some cases do not have, and of figures that hardly differ."""

import numpy as np
import pytest

from sim.campaign.pictures import counts, distributions, not_exceeded

ONE = 1 / 3


def test_a_part_without_any_value_is_in_the_legend_alone():
    drawn = distributions({"calm": {"off": np.arange(3.0)}, "rough": {"off": np.full(3, np.nan)}}, ["off"])
    assert [text.get_text() for text in drawn.legends[0].get_texts()] == ["calm", "rough"]
    assert [len(line.get_xdata()) for line in drawn.axes[0].get_lines()] == [4, 0]


def test_a_curve_ends_at_the_share_of_the_cases_that_have_the_figure():
    some = np.array([np.nan, 1.0, np.nan, 2.0])
    drawn = distributions({"calm": {"off": np.arange(4.0)}, "rough": {"off": some}}, ["off"])
    assert [line.get_ydata()[-1] for line in drawn.axes[0].get_lines()] == [100.0, 50.0]


@pytest.mark.parametrize("values", [[ONE, np.nextafter(ONE, 1)], [0.0], [1e17], [-2.0, np.nextafter(-2.0, 0)]])
def test_values_that_differ_by_round_off_are_one_bar(values):
    drawn = distributions({"all cases": {"off": np.array(values * 10)}}, ["off"])
    assert [bar.get_height() for bar in drawn.axes[0].patches] == [len(values) * 10]
    drawn.canvas.draw()


@pytest.mark.parametrize(("n", "least"), [(3, 3), (9, 9), (19, 19), (20, 19), (100, 95)])
def test_what_95_percent_do_not_exceed_is_not_exceeded_by_more(n, least):
    """Between the two largest of nine there is a value that one in nine exceeds."""
    values = np.arange(1.0, n + 1)
    assert not_exceeded(values, 0.95) == least
    drawn = distributions({"all cases": {"off": values}}, ["off"])
    assert n < 8 or drawn.axes[0].get_lines()[-1].get_xdata()[0] == least


def test_cases_are_whole_numbers_on_their_axis():
    ticks = distributions({"all cases": {"off": np.arange(9.0)}}, ["off"]).axes[0].get_yticks()
    assert ticks.tolist() == np.round(ticks).tolist()


def test_no_two_parts_of_a_grid_look_alike_as_bars():
    bars = counts({f"wind {k}": {"named": 1} for k in range(12)}).axes[0].patches
    assert len({(bar.get_facecolor(), bar.get_hatch()) for bar in bars}) == len(bars) == 12


def test_values_that_differ_have_more_bars():
    drawn = distributions({"all cases": {"off": np.arange(20.0)}}, ["off"])
    heights = [bar.get_height() for bar in drawn.axes[0].patches]
    assert len(heights) == 8 and sum(heights) == 20
