"""A table in the axes of mathematics and ROS is no boat whose sides are mirrored. Seeds from 7300 on."""

import numpy as np
import polars as pl
import pytest
from msgspec.structs import replace

from companion.core.geometry.frames import rotate
from companion.logs.runs.run import LogProblem, Run, RunMeta
from sim.fitting.engine.split import NamedLog
from sim.fitting.wiring.check import Checked, checked
from sim.fitting.wiring.decision import has_own_axes
from tests.sim.fitting.wiring.miswired import BOAT, RP, changed, drive

SEED = 7300
SIDES, MIRRORED, MATHEMATICAL = "mirrored:port_starboard", "axes:enu", "heading:mathematical"
EAST = {"psi_rad": (1.5 * np.pi - pl.col("psi_rad")) % (2 * np.pi) - np.pi}
"""Heading counter-clockwise from east."""
XY = {"north_m": pl.col("east_m"), "east_m": pl.col("north_m")}
FLU = {"r_rad_s": -pl.col("r_rad_s"), "ay_m_s2": -pl.col("ay_m_s2"), "theta_rad": -pl.col("theta_rad")}
NO_IMU = dict.fromkeys(("r_rad_s", "ax_m_s2", "ay_m_s2"), pl.lit(None, pl.Float64))
ONE_TURNED = {f"pwm_{RP}": 3000.0 - pl.col(f"pwm_{RP}")}
long = pytest.mark.long


def table(run: Run, **columns: pl.Expr) -> Run:
    """The log as a table of somebody's own, which says nothing of where its columns come from."""
    return Run(changed(run, **columns).table, RunMeta(source="table.csv"))


def check(run: Run) -> Checked:
    return checked([NamedLog("table.csv", run)], [], BOAT)


@pytest.fixture(scope="module")
def right() -> Run:
    return drive(seed=SEED)


@pytest.mark.parametrize(
    ("columns", "names"),
    [
        (EAST | XY, [MIRRORED]),
        pytest.param(EAST, [MATHEMATICAL], marks=long),
        pytest.param(EAST | FLU, [MATHEMATICAL, "imu:upside_down"], marks=long),
        pytest.param(EAST | XY | NO_IMU | {"r_rad_s": pl.col("r_rad_s")}, [MIRRORED], marks=long),
        pytest.param({"psi_rad": -pl.col("psi_rad"), "east_m": -pl.col("east_m")}, [MIRRORED], marks=long),
        pytest.param(EAST | XY | ONE_TURNED, [MIRRORED, f"reversed:{RP}"], marks=long),
        pytest.param({}, [], marks=long),
    ],
)  # fmt: skip
def test_axes_of_mathematics_are_named_and_put_right_and_no_motor_is_blamed(right, columns, names):
    found = check(table(right, **columns))
    assert [f.name for f in found.wiring.corrected] == names, found.wiring
    assert (found.vessel is BOAT) == (f"reversed:{RP}" not in names)
    again = checked(found.logs, [], found.vessel)
    assert again.wiring.findings == ()


def test_what_is_put_right_is_the_right_log_but_for_a_turn_of_the_whole_world(right):
    found = check(table(right, **EAST, **XY)).logs[0].run.table
    psi, other = (t["psi_rad"].drop_nulls().to_numpy() for t in (found, right.table))
    off = (psi - other + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(off, off[0], atol=1e-9)
    (north, east), place = ([t[c].drop_nulls().to_numpy() for c in XY] for t in (found, right.table))
    np.testing.assert_allclose(np.array(rotate(off[0], *place)), np.array([north, east]), atol=1e-9)
    assert found["r_rad_s"].equals(right.table["r_rad_s"])


@pytest.mark.parametrize("columns", [EAST | XY | FLU, pytest.param(EAST | XY | NO_IMU, marks=long)])
def test_a_log_in_which_all_is_mirrored_or_nothing_else_known_is_told_from_mirrored_sides_by_a_turn(right, columns):
    found = check(table(right, **columns))
    (one,) = found.wiring.findings
    assert one.name == SIDES and not one.certain and len(one.rivals) == 1 and "ROS" in one.rivals[0]
    assert found.vessel is BOAT and found.logs[0].run.table.equals(changed(right, **columns).table)
    (line,) = found.wiring.lines
    assert "turn the boat to starboard by hand" in line and "leave the thrusters as they are" in line


@long
def test_sides_that_are_mirrored_are_as_doubtful_in_a_table_and_certain_in_a_log_whose_axes_are_known():
    run = drive(SIDES, seed=SEED + 1)
    for log, certain in ((run, True), (table(run), False)):
        (one,) = check(log).wiring.findings
        assert one.name == SIDES and one.certain == certain


@long
def test_another_fault_beside_mirrored_sides_is_as_doubtful(right):
    (one,) = check(table(right, **EAST, **XY, **FLU, **ONE_TURNED)).wiring.findings
    assert one.name.startswith(SIDES) and "+reversed:" in one.name and not one.certain and one.test


def test_axes_are_known_where_the_log_says_where_pulse_widths_come_from_and_nobody_edited_it(right):
    edited = LogProblem(kind="edited", text="the data is not what was written with its hash")
    assert not has_own_axes(right)
    assert has_own_axes(right.with_notes([edited]))
    assert has_own_axes(Run(right.table, replace(right.meta, columns={"psi_rad": "mine"})))
