"""What a fit makes of positions that a table repeats, of absurd voltages, and of logs of several boats. Seed 8."""

import polars as pl
import pytest
from msgspec.structs import replace

from companion.logs.readers.gps import NO_FIX
from companion.logs.readers.outputs import GUESSED
from companion.logs.runs.run import LogProblem, Run
from sim.fitting.diagnose.report.sentences import TOLD
from sim.fitting.engine.split import UNCERTAIN, JobError, NamedLog, split, usable
from sim.fitting.identify.verdict import DOUBTFUL
from sim.fitting.wiring.check import checked
from sim.world.teleop_log import teleop_run
from tests.support.vessel_fixtures import boat

VESSEL = boat("aritra")


def test_positions_that_are_held_until_the_next_are_used_where_they_were_new():
    """A table that was filled forward says each position up to a period late."""
    run = teleop_run(VESSEL, 8, 80.0)
    filled = run.table.with_columns(pl.col("north_m", "east_m").forward_fill())
    assert filled["north_m"].null_count() < run.table["north_m"].null_count()
    (used,) = split([NamedLog("a.csv", Run(filled, run.meta))], [], VESSEL).used
    for column in ("north_m", "east_m"):
        assert used.log.run.table[column].equals(run.table[column])
    (note,) = [n for n in used.log.run.meta.notes if n.kind == "held readings"]
    assert "rows repeat the reading before" in note.text
    rests = pl.col("t_s") > 60.0
    resting = run.table.with_columns(
        pl.when(rests).then(1.0).otherwise(pl.col(name)).alias(name) for name in ("north_m", "east_m")
    )
    (used,) = split([NamedLog("a.csv", Run(resting, run.meta))], [], VESSEL).used
    assert used.log.run.table["north_m"].equals(resting["north_m"]) and not used.log.run.meta.notes


def test_heading_and_inertial_readings_that_are_held_are_used_where_they_were_new():
    """Taken as they stand, they made the thrust 48 ms later, with an interval of 6 ms (10 Hz in a table of 50 Hz)."""
    run = teleop_run(VESSEL, 8, 80.0)
    inertial = ["psi_rad", "r_rad_s", "ax_m_s2", "ay_m_s2"]
    fresh = pl.col("psi_rad").is_not_null() & (pl.col("psi_rad").is_not_null().cum_sum() % 5 == 1)
    slow = run.table.with_columns(pl.when(fresh).then(pl.col(name)).alias(name) for name in inertial)
    filled = slow.with_columns(pl.col(inertial).forward_fill())
    (used,) = split([NamedLog("a.csv", Run(filled, run.meta))], [], VESSEL).used
    for name in inertial:
        assert used.log.run.table[name].equals(slow[name]), name
    (note,) = [n for n in used.log.run.meta.notes if n.kind == "held readings"]
    assert note.text.startswith("psi_rad: ") and "ay_m_s2: " in note.text


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        (["t_s"], r"a.csv: t_s: a heading comes every [0-9]+ s only: is the time in milliseconds"),
        (["north_m", "east_m"], "m/s: are they in millimetres"),
    ],
)
def test_times_and_positions_in_other_units_are_refused(columns, words):
    """Milliseconds kept a fit busy until its memory was full, millimetres ended in "the Hessian is not positive"."""
    run = teleop_run(VESSEL, 8, 80.0)
    thousandfold = Run(run.table.with_columns(pl.col(columns) * 1000.0), run.meta)
    with pytest.raises(JobError, match=words):
        split([NamedLog("a.csv", thousandfold)], [], VESSEL)
    (passed_on,) = checked([NamedLog("a.csv", thousandfold)], [], VESSEL).logs
    assert passed_on.run is thousandfold


def test_a_voltage_that_the_pack_cannot_have_is_none():
    """A boat without a battery monitor says 0 V, which would make every thrust 0 N."""
    run = teleop_run(VESSEL, 8, 80.0)
    rows = run.table["t_s"]
    late = run.table.with_columns(pl.when(rows > 40.0).then(0.0).otherwise(pl.lit(15.2)).alias("battery_v"))
    for table, first in ((run.table.with_columns(pl.lit(0.0).alias("battery_v")), None), (late, 15.2)):
        (used,) = split([NamedLog("a.csv", Run(table, run.meta))], [], VESSEL).used
        assert used.log.run.table["battery_v"].drop_nulls().unique().to_list() == ([first] if first else [])
        (note,) = (n for n in used.log.run.meta.notes if n.kind == "dead sensor")
        assert "(the first 0 V) are none of a pack of 15 V: left out" in note.text


@pytest.mark.long
def test_logs_that_state_several_boats_say_so():
    def notes(*boats):
        runs = [teleop_run(VESSEL, seed, 60.0) for seed in range(len(boats))]
        logs = [NamedLog(f"{k}.csv", Run(r.table, replace(r.meta, vessel=boats[k]))) for k, r in enumerate(runs)]
        return [
            [n.text for n in use.log.run.meta.notes if n.kind == "another boat"] for use in split(logs, [], VESSEL).used
        ]

    one, other, unknown = notes("alba", "bora", "not stated")
    assert one[0].startswith("it states alba, others bora") and other[0].startswith("it states bora, others alba")
    assert not unknown and notes("alba", "alba", "not stated") == [[], [], []]


def test_a_boat_that_is_never_commanded_is_refused():
    """Of a log with outputs that drive nothing a boat was fitted that moves by itself."""
    run = teleop_run(VESSEL, 8, 80.0)
    still = run.table.with_columns(pl.lit(1510.0).alias(f"pwm_{name}") for name in run.thrusters)
    log = NamedLog("a.BIN", Run(still, replace(run.meta, columns={"pwm": "RCOU: output 1"})))
    with pytest.raises(JobError, match=r"a.BIN: no thruster ever leaves neutral.*source of the pulses: RCOU"):
        split([log], [], VESSEL)
    assert usable(log, VESSEL, at_rest=True).run.thrusters == run.thrusters, "a reference may lie in the harbour"


@pytest.mark.parametrize(("kind", "words"), [(NO_FIX, "without position: none of 3 GPS fixes"), ("other", "--uwb")])
def test_what_the_reader_knows_of_a_missing_position_is_the_reason(kind, words):
    run = teleop_run(VESSEL, 8, 80.0)
    blind = run.table.with_columns(pl.lit(None, pl.Float64).alias(name) for name in ("north_m", "east_m"))
    log = Run(blind, run.meta).with_notes([LogProblem(kind=kind, text="none of 3 GPS fixes is good")])
    with pytest.raises(JobError, match=words):
        split([NamedLog("a.BIN", log)], [], VESSEL)


def test_of_measured_wind_it_is_said_who_uses_it():
    run = teleop_run(VESSEL, 8, 80.0)
    windy = Run(run.table.with_columns(V_w_m_s=pl.lit(5.0), beta_w_deg=pl.lit(90.0)), run.meta)
    (used,) = split([NamedLog("a.csv", windy)], [], VESSEL).used
    (note,) = used.log.run.meta.notes
    assert note.kind == "measured wind" and note.text.startswith("V_w_m_s, beta_w_deg: identify has this wind where")


def test_pulses_that_may_not_be_what_was_driven_are_told_by_identify_and_diagnose():
    assert {*UNCERTAIN} <= {*DOUBTFUL} and {*UNCERTAIN} <= {*TOLD}
    assert {"no pulse", "constant", GUESSED} <= {*UNCERTAIN}
