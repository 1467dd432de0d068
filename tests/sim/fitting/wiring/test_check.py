"""Signs and sides: wrong ones are named and put right, right ones are left alone. Seeds from 7100 on."""

import numpy as np
import polars as pl
import pytest
from msgspec.structs import replace

from companion.core.model.load_vessel import load_vessel
from companion.core.model.thrusters import configuration_matrix
from companion.core.model.vessel_text import vessel_toml
from companion.logs.runs.run import Run
from sim.fitting.engine.split import NamedLog
from sim.fitting.wiring.check import Checked, checked
from sim.world.teleop_log import teleop_run
from tests.sim.fitting.wiring.miswired import BESIDE, BOAT, FAULTS, FP, FS, IMU_DEG, RP, RS, changed, drive, miswired

SEED = 7100
RATE = pl.col("r_rad_s")
SLOW_DEG_S = pl.when(RATE.abs() < 0.6).then(np.degrees(1) * RATE)  # a column holds up to 35
ALWAYS = (f"swapped:{FP}+{RP}", "imu:90")
long = pytest.mark.long


def check(*runs: Run, **more) -> Checked:
    return checked([NamedLog(f"log{i}", run) for i, run in enumerate(runs)], [], BOAT, **more)


def put_right(found: Checked) -> list[str]:
    return [f.name for f in found.wiring.corrected]


@pytest.fixture(scope="module")
def right() -> Run:
    return drive(seed=SEED)


@pytest.mark.parametrize("fault", [f if f in ALWAYS else pytest.param(f, marks=long) for f in FAULTS])
@pytest.mark.long
def test_each_fault_is_named_and_put_right(fault):
    run = drive(fault, seed=SEED + 1 + FAULTS.index(fault))
    found = check(run)
    assert put_right(found) == [fault], found.wiring
    B, true = (configuration_matrix(v) for v in (found.vessel, miswired(fault)))
    np.testing.assert_array_equal(B, true)
    assert [t.mirrored for t in found.vessel.thrusters] == [t.mirrored for t in miswired(fault).thrusters]
    assert load_vessel(vessel_toml(found.vessel), name="wiring.toml") == found.vessel
    again = checked(found.logs, [], found.vessel)
    assert again.wiring.findings == () and again.vessel == found.vessel and again.logs == found.logs


@pytest.mark.long
@pytest.mark.parametrize("beside", ["compass", *(pytest.param(b, marks=long) for b in BESIDE if b != "compass")])
def test_right_logs_are_left_alone_whatever_else_is_wrong(beside):
    run = drive("", beside, seed=SEED + 20, alone_s=0.0)
    found = check(run)
    assert found.wiring.findings == () and found.vessel is BOAT
    assert found.logs[0].run is run


@long
@pytest.mark.parametrize("beside", ["compass", "weak thruster"])
def test_another_cause_beside_hides_none(beside):
    assert put_right(check(drive(f"swapped:{FP}+{RP}", beside, seed=SEED + 30))) == [f"swapped:{FP}+{RP}"]


@long
def test_what_pushes_alike_is_told_and_left_as_it_is():
    """By allocated commands alone a swap fore and aft to port is as one to starboard: both are told, none is taken."""
    found = check(drive(f"swapped:{FP}+{RP}", seed=SEED + 40, alone_s=0.0, seconds=180.0, uwb_hz=5.0))
    (one,) = found.wiring.findings
    assert {one.name} < {f"swapped:{FP}+{RP}", f"swapped:{FS}+{RS}"} and not one.certain
    assert len(one.rivals) == 1 and found.vessel is BOAT
    assert "push alone" in found.wiring.lines[0] and "no fit to them is to be trusted" in found.wiring.lines[0]


@pytest.mark.long
def test_as_found_tells_and_leaves_everything():
    run = drive("mirrored:port_starboard", seed=SEED + 50)
    found = check(run, as_found=True)
    assert found.wiring.findings[0].name == "mirrored:port_starboard" and found.wiring.corrected == ()
    assert found.vessel is BOAT and found.logs[0].run is run and "--as-found" in found.wiring.lines[0]


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "columns"),
    [
        ("gyro:reversed", {"r_rad_s": -pl.col("r_rad_s")}),
        pytest.param("gyro:degrees", {"r_rad_s": SLOW_DEG_S}, marks=long),
        ("heading:reversed", {"psi_rad": -pl.col("psi_rad")}),
        pytest.param("heading:90", {"psi_rad": (pl.col("psi_rad") + 1.5 * np.pi) % (2 * np.pi) - np.pi}, marks=long),
        pytest.param("positions:swapped", {"north_m": pl.col("east_m"), "east_m": pl.col("north_m")}, marks=long),
        pytest.param("positions:east", {"east_m": -pl.col("east_m")}, marks=long),
        pytest.param("positions:north", {"north_m": -pl.col("north_m")}, marks=long),
        pytest.param("accelerations:y", {"ay_m_s2": -pl.col("ay_m_s2")}, marks=long),
        ("accelerations:unit", {"ax_m_s2": pl.col("ax_m_s2") / 9.81, "ay_m_s2": pl.col("ay_m_s2") / 9.81}),
        ("imu:upside_down", {"ay_m_s2": -pl.col("ay_m_s2"), "r_rad_s": -pl.col("r_rad_s")}),
    ],
)  # fmt: skip
def test_wrong_columns_are_named_and_put_right(right, name, columns):
    found = check(changed(right, **columns))
    assert put_right(found) == [name], found.wiring
    table = found.logs[0].run.table
    for column in columns:
        off = (table[column] - right.table[column]).drop_nulls().to_numpy()
        if column == "psi_rad":
            off = (off + np.pi) % (2 * np.pi) - np.pi
        np.testing.assert_allclose(off, 0.0, atol=0.05)


@long
def test_logs_are_asked_together_and_one_that_says_otherwise_is_named(right):
    swapped = drive(f"swapped:{FP}+{FS}", seed=SEED + 60)
    found = check(swapped, right)
    assert put_right(found) == [] and found.vessel is BOAT
    assert found.wiring.findings == () or found.wiring.findings[0].against


@long
def test_a_reference_from_before_is_left_out_and_one_from_after_is_kept(right):
    fault = "reversed:all"
    other = drive(fault, seed=SEED + 71)
    for calm, kept in ((right, 0), (other, 1)):
        found = check(drive(fault, seed=SEED + 70), reference=[NamedLog("calm", calm)])
        assert len(found.reference) == kept
        assert ("Left out: calm" in " ".join(found.wiring.lines)) == (not kept)


@long
def test_held_out_logs_are_put_right_alike():
    runs = [drive("imu:90", seed=SEED + 80 + i) for i in range(2)]
    found = checked([NamedLog("a", runs[0])], [NamedLog("b", runs[1])], BOAT)
    assert found.wiring.findings[0].logs == ("a", "b") and IMU_DEG["imu:90"] == 90
    assert checked(found.logs, found.held_out, BOAT).wiring.findings == ()


@long
@pytest.mark.parametrize("gain", [0.0, 0.4])
def test_a_weak_or_dead_thruster_is_left_to_the_fit(gain):
    """A dead one is half-way to one that pushes the wrong way."""
    true = replace(BOAT, thrusters=(replace(BOAT.thrusters[0], gain=gain), *BOAT.thrusters[1:]))
    found = check(teleop_run(true, SEED + 90, 120.0, believed=BOAT, alone_s=2.0))
    assert found.wiring.findings == () and found.vessel is BOAT


@long
def test_a_dead_thruster_hides_no_doubt_about_the_axes():
    true = replace(BOAT, thrusters=(replace(BOAT.thrusters[0], gain=0.0), *BOAT.thrusters[1:]))
    run = teleop_run(true, SEED + 91, 120.0, believed=BOAT, alone_s=2.0)
    still = changed(run, north_m=pl.when(pl.col("north_m").is_not_null()).then(15.0), east_m=0.0 * pl.col("east_m"))
    found = check(still).wiring
    assert found.findings == ()
    assert {"north_m counts to the south", "east_m counts to the west"} <= set(found.unknown)


def test_logs_that_hold_too_little_say_so_and_are_passed_on(right):
    short = Run(right.table.filter(pl.col("t_s") < 5.0), right.meta)
    found = check(short)
    assert found.logs[0].run is short and "too little" in found.wiring.open_lines[0]
    renamed = Run(right.table.rename({f"pwm_{FP}": "pwm_other"}), right.meta)
    assert check(renamed).logs[0].run is renamed


def test_a_boat_that_only_rests_shows_nothing(right):
    still = changed(right, **{f"pwm_{n}": pl.lit(1500.0) for n in (FP, FS, RP, RS)})
    found = check(still)
    assert found.wiring.findings == () and "cannot tell whether" in found.wiring.open_lines[0]
