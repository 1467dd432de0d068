"""Plots: the arrays hold what was logged, and any part of a log may be absent."""

import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from companion.boat.recorder import Recorder
from companion.core.messages import (
    GroundTruth,
    GuidanceReference,
    LoopTiming,
    OverrideLease,
    StateEstimate,
    Tick,
)
from companion.logs.export.plot import draw, heading, pwm, track
from companion.logs.log_file import LogFile
from companion.logs.series import collect


def record(path, *messages) -> LogFile:
    with Recorder(path, {}, lambda: 0, wall_offset_ns=0) as recorder:
        for message in messages:
            recorder.record(message)
    return LogFile(path)


def truth_at(t_ns: int) -> GroundTruth:
    return GroundTruth(t_ns=t_ns, north_m=1.0, east_m=2.0, psi_rad=0.0, u_m_s=0.0, v_m_s=0.0, r_rad_s=0.0, f_n=())


def labels(figure: Figure) -> list[str]:
    return [text for axes in figure.axes for text in axes.get_legend_handles_labels()[1]]


def test_arrays_hold_what_was_logged(drive_log):
    log = LogFile(drive_log(10.0))
    series = collect(log)
    estimates = [m for m in log.messages(StateEstimate) if isinstance(m, StateEstimate)]
    np.testing.assert_array_equal(series[StateEstimate]["north_m"], [m.north_m for m in estimates])
    np.testing.assert_allclose(series[Tick].t_s, np.arange(100) / 10, atol=1e-9)
    assert series.pwm_us.shape == (100, 4)
    assert series.sources.count("shifted_plan") == 6
    assert set(series.innovations) == {"range A1", "range A2", "range A3", "range A4"}
    assert series.site is not None
    assert series.site.name == "pond"


def test_the_tag_is_where_it_was_by_position_and_by_ranges(drive_log):
    series = collect(LogFile(drive_log(20.0)))
    truth = np.column_stack([series[GroundTruth]["north_m"], series[GroundTruth]["east_m"]])[::5]
    positions, fixes = np.split(series.uwb_ne_m, 2)  # logged with 0.1 m noise each
    assert np.sqrt(((positions - truth) ** 2).mean()) < 0.15
    assert np.sqrt(((fixes - truth) ** 2).mean()) < 0.15


@pytest.mark.long
def test_all_panels_are_drawn_and_the_track_has_equal_axes(drive_log):
    figure = Figure()
    draw(figure, collect(LogFile(drive_log(10.0))), "title")
    assert {axes.get_title(loc="left") for axes in figure.axes} == {
        "Track", "Cross-track error", "Heading", "Speeds over ground", "Thruster PWM", "Innovations, normalised",
        "Loop timing",
    }  # fmt: skip
    assert figure.axes[0].get_aspect() == 1.0
    assert {"estimate", "ground truth", "fallback shifted_plan: 6", "thruster on channel 4"} <= set(labels(figure))


def test_thrusters_have_the_names_of_the_vessel_file(tmp_path):
    lease = OverrideLease(
        t_ns=0, index=0, channels=(9, 10), pwm_us=(1600, 1400), valid_for_s=0.3, source="plan", reason="",
        f_command_n=(1.0, -1.0),
    )  # fmt: skip
    vessel = {"config/vessel.toml": 'thrusters = [{name = "bow"}, {name = "stern"}]'}
    for about, names in (
        (vessel, ("bow", "stern")),
        ({"config/vessel.toml": "a ="}, ("thruster on channel 9", "thruster on channel 10")),
    ):
        path = tmp_path / f"{len(names[0])}.mcap"
        with Recorder(path, about, lambda: 0, wall_offset_ns=0) as recorder:
            recorder.record(lease)
        assert collect(LogFile(path)).thrusters == names


@pytest.mark.long
def test_no_legend_lies_on_a_title(drive_log):
    figure = Figure(figsize=(15, 10), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    series = collect(LogFile(drive_log(10.0)))
    draw(figure, replace(series, thrusters=("a thruster with a long name",) * 4), "title")
    figure.draw_without_rendering()
    for axes in figure.axes:
        name = axes.get_title(loc="left")
        (title,) = (text for text in axes.findobj(Text) if text.get_text() == name)
        assert not axes.get_legend().get_window_extent().overlaps(title.get_window_extent()), name


def test_a_log_of_ticks_alone_still_gives_a_picture(tmp_path):
    log = record(tmp_path / "t.mcap", Tick(t_ns=5, index=0, lateness_ns=1_000_000))
    figure = Figure()
    draw(figure, collect(log), "title")
    figure.savefig(tmp_path / "t.png")
    assert labels(figure) == ["tick lateness: p99 1, max 1"]


def test_unknown_ages_and_headings_that_wrap_are_no_lines(tmp_path):
    reference = [
        GuidanceReference(
            t_ns=k, phase="idle", leg=0, waypoints_passed=0, x_e_m=0.0, y_e_m=0.0, path_angle_rad=0.0,
            psi_ref_rad=psi, u_ref_m_s=0.0, north_ref_m=0.0, east_ref_m=0.0,
        )
        for k, psi in enumerate((3.1, 3.14, -3.14, -3.1))
    ]  # fmt: skip
    timing = LoopTiming(t_ns=9, index=0, lateness_ms=0.0, imu_to_override_ms=None)
    figure = Figure()
    draw(figure, collect(record(tmp_path / "t.mcap", *reference, timing)), "title")
    heading = next(axes for axes in figure.axes if axes.get_title(loc="left") == "Heading")
    drawn = np.asarray(heading.get_lines()[0].get_ydata(), dtype=float)
    assert np.isnan(drawn[2])
    assert np.nanmax(np.abs(np.diff(drawn))) < 3.0
    assert "no leg driven" in " ".join(labels(figure))
    assert not any("IMU" in label for label in labels(figure))


def test_lines_and_shades_end_where_the_log_has_a_gap(tmp_path):
    """A minute is missing: as in a damaged log, or of what guidance asks for where the boat was stopped meanwhile."""
    lease = OverrideLease(
        t_ns=0, index=0, channels=(9,), pwm_us=(1500,), valid_for_s=0.3, source="neutral", reason="", f_command_n=(0.0,)
    )
    at_ns = [k * 10**8 for k in (0, 1, 2, 600, 601, 602)]
    messages = [m for t_ns in at_ns for m in (truth_at(t_ns), msgspec.structs.replace(lease, t_ns=t_ns))]
    series = collect(record(tmp_path / "t.mcap", *messages))
    for panel, label in ((track, "ground truth"), (heading, "truth"), (pwm, "thruster on channel 9")):
        axes = Figure().add_subplot()
        panel(axes, series)
        (line,) = (line for line in axes.get_lines() if line.get_label() == label)
        assert np.isnan(np.asarray(line.get_ydata(), dtype=float)).tolist() == [False, False, True, False, False, False]
        shades = [path for shade in axes.collections for path in shade.get_paths()]
        assert all(path.get_extents().width < 1.0 for path in shades)
        assert len(shades) == (2 if panel is pwm else 0)


def test_times_beyond_a_hundred_milliseconds_have_no_exponent_and_titles_are_no_formulas(tmp_path):
    figure = Figure()
    series = collect(record(tmp_path / "t.mcap", Tick(t_ns=5, index=0, lateness_ns=253_000_000)))
    draw(figure, series, "a title is no formula: cost$%$.mcap")
    figure.draw_without_rendering()
    assert labels(figure) == ["tick lateness: p99 250, max 250"]


def test_ground_truth_comes_from_the_simulators_log_for_the_time_of_this_one(tmp_path):
    log = record(tmp_path / "boat.mcap", Tick(t_ns=1_000_000_000, index=0), Tick(t_ns=3_000_000_000, index=1))
    truth = record(tmp_path / "sim.mcap", *(truth_at(k * 500_000_000) for k in range(10)))
    assert collect(log, truth)[GroundTruth].t_s.tolist() == [0.0, 0.5, 1.0, 1.5, 2.0]


def test_channels_held_at_neutral_are_no_thrusters(tmp_path):
    lease = OverrideLease(
        t_ns=0, index=0, channels=(1, 3, 5), pwm_us=(1600, 1400, 1500), valid_for_s=0.3, source="plan", reason="",
        f_command_n=(1.0, -1.0),
    )  # fmt: skip
    series = collect(record(tmp_path / "t.mcap", lease))
    assert series.pwm_us.tolist() == [[1600.0, 1400.0]]
    assert math.isclose(series.lease_t_s[0], 0.0)
