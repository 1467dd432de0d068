"""What a fit makes of positions that a table repeats. Seed 8."""

import polars as pl

from companion.logs.runs.run import Run
from sim.fitting.engine.split import NamedLog, split
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
    (note,) = [n for n in used.log.run.meta.notes if n.kind == "held positions"]
    assert "rows repeat the position before" in note.text
    rests = pl.col("t_s") > 60.0
    resting = run.table.with_columns(
        pl.when(rests).then(1.0).otherwise(pl.col(name)).alias(name) for name in ("north_m", "east_m")
    )
    (used,) = split([NamedLog("a.csv", Run(resting, run.meta))], [], VESSEL).used
    assert used.log.run.table["north_m"].equals(resting["north_m"]) and not used.log.run.meta.notes
