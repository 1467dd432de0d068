"""A log as tables: every number of every message comes back, in either format, on one time base."""

import json

import msgspec
import polars as pl
import pytest
from msgspec import inspect
from polars.testing import assert_frame_equal

from companion.boat.recorder import Recorder
from companion.cli import log as log_cli
from companion.core import messages as m
from companion.logs.export import command
from companion.logs.export.tables import dtype_of, tables, write
from companion.logs.log_file import LogFile
from companion.logs.schema import KINDS
from companion.logs.series import collect
from companion.logs.summary import summarise


def record(path, *messages, wall_offset_ns: int = 0) -> LogFile:
    with Recorder(path, {}, lambda: 0, wall_offset_ns=wall_offset_ns) as recorder:
        for message in messages:
            recorder.record(message)
    return LogFile(path)


@pytest.mark.parametrize("kind", KINDS.values(), ids=lambda kind: kind.__name__)
def test_every_message_has_a_form_as_a_table(kind):
    for field in msgspec.structs.fields(kind):
        told = inspect.type_info(field.type)
        if not isinstance(told, inspect.DictType):
            assert dtype_of(told)


def test_tables_hold_what_was_logged_number_by_number(drive_log):
    log = LogFile(drive_log(30.0))
    found = tables(log).by_topic
    for topic, names in (
        ("state_estimate", ("t_ns", "north_m", "psi_rad", "u_m_s", "health")),
        ("guidance_reference", ("t_ns", "phase", "y_e_m")),
        ("loop_timing", ("t_ns", "lateness_ms", "imu_to_override_ms", "sent")),
    ):
        logged = list(log.messages(KINDS[f"/{topic}"]))
        assert found[topic].select(names).rows() == [tuple(getattr(x, n) for n in names) for x in logged]
    estimates = [x for x in log.messages(m.StateEstimate) if isinstance(x, m.StateEstimate)]
    covariance = found["state_estimate"].select(pl.col("^covariance_.*$"))
    assert covariance.rows() == [x.covariance for x in estimates]
    assert found["state_estimate"]["anchor_bias_m_A1"].to_list() == [0.02] * len(estimates)
    leases = [x for x in log.messages(m.OverrideLease) if isinstance(x, m.OverrideLease)]
    assert found["override_lease"].select(pl.col("^pwm_us_.*$")).rows() == [x.pwm_us for x in leases]


def test_one_row_a_range_and_lists_of_vectors_stay_lists(drive_log):
    log = LogFile(drive_log(5.0))
    found = tables(log).by_topic
    cycles = [x for x in log.messages(m.UwbRanges) if isinstance(x, m.UwbRanges)]
    ranges = [(x.t_ns, r.anchor, r.range_m) for x in cycles for r in x.ranges]
    assert found["uwb_ranges"].select("t_ns", "anchor", "range_m").rows() == ranges
    assert found["plan_result"]["x"][0].to_list() == [[0.0] * 10] * 4


def test_one_time_base_for_all_topics(drive_log):
    log = LogFile(drive_log(3.0))
    found = tables(log)
    first_ns = next(log.messages()).t_ns
    for table in found.by_topic.values():
        assert table["t_s"].to_list() == pytest.approx([(t - first_ns) / 1e9 for t in table["t_ns"]], abs=1e-9)
        unix_s = [(t + log.wall_offset_ns) / 1e9 for t in table["t_ns"]]
        assert table["unix_s"].to_list() == pytest.approx(unix_s, abs=1e-6, rel=0)


def test_a_log_that_does_not_know_the_wall_clock_leaves_unix_time_blank(tmp_path):
    found = tables(record(tmp_path / "t.mcap", m.Tick(t_ns=7, index=0), m.Tick(t_ns=8, index=1)))
    assert found.by_topic["tick"]["unix_s"].to_list() == [None, None]
    assert found.wall_offset_ns is None


def test_vectors_that_grow_and_names_that_come_later_leave_blanks(tmp_path, monkeypatch):
    monkeypatch.setattr("companion.logs.export.tables.BATCH", 1)  # each message a piece of its own
    pwm = [(1500,), (1500, 1600), (1500, 1600, 1700)]
    log = record(tmp_path / "t.mcap", *(m.ServoOutput(t_ns=k, pwm_us=p) for k, p in enumerate(pwm)))
    assert tables(log).by_topic["servo_output"].select(pl.col("^pwm_us_.*$")).rows() == [
        (1500, None, None), (1500, 1600, None), (1500, 1600, 1700),
    ]  # fmt: skip


def test_csv_and_parquet_come_back_the_same(drive_log, tmp_path):
    found = tables(LogFile(drive_log(5.0)))
    write(found, tmp_path / "csv", "csv", {})
    write(found, tmp_path / "parquet", "parquet", {})
    for topic, table in found.by_topic.items():
        assert_frame_equal(pl.read_parquet(tmp_path / "parquet" / f"{topic}.parquet"), table)
        back = pl.read_csv(tmp_path / "csv" / f"{topic}.csv", schema_overrides=_flat(table))
        for name, dtype in table.schema.items():
            if isinstance(dtype, pl.List):
                texts = back[name].to_list()
                assert [json.loads(text) for text in texts] == table[name].to_list()
            elif dtype == pl.String:
                assert back[name].fill_null("").to_list() == table[name].fill_null("").to_list()
            else:
                assert back[name].to_list() == table[name].to_list()


def _flat(table: pl.DataFrame) -> dict:
    return {name: pl.String if isinstance(dtype, pl.List) else dtype for name, dtype in table.schema.items()}


def test_the_command_writes_a_folder_and_never_over_another(drive_log, tmp_path, capsys):
    log, out = drive_log(2.0), tmp_path / "tables"
    assert command.export_topics(log, out, "csv") == log_cli.OK
    assert "wrote 11 tables" in capsys.readouterr().out
    index = json.loads((out / "log.json").read_text())
    assert index["topics"]["tick"] == {"file": "tick.csv", "rows": 20}
    assert index["vessel"] == "synthetic"
    with pytest.raises(command.LogError, match=r"alert\.csv: exists already"):
        command.export_topics(log, out, "csv")
    with pytest.raises(command.LogError, match=r"log\.json: exists already"):
        command.export_topics(log, out, "parquet")
    assert json.loads((out / "log.json").read_text()) == index
    assert not list(out.glob("*.parquet"))


def test_tables_plot_and_info_count_from_the_same_message(tmp_path):
    """They began with the first message, the first that a plot shows, and the time of the first recording."""
    clock = [10**9]
    with Recorder(tmp_path / "boat.mcap", {}, lambda: clock[0], wall_offset_ns=10**18, background=False) as recorder:
        for message in (
            m.LinkStatus(t_ns=10**9, link="mavlink", state="searching", reason=""),
            m.Tick(t_ns=2 * 10**9, index=0),
            m.Alert(t_ns=3 * 10**9, level="info", text="x"),
        ):
            recorder.record(message)
            clock[0] += 10**8
    log = LogFile(tmp_path / "boat.mcap")
    found = tables(log).by_topic
    assert found["tick"]["t_s"].to_list() == collect(log)[m.Tick].t_s.tolist() == [1.0]
    assert found["alert"]["t_s"].to_list() == [alert.t_s for alert in summarise(log).alerts] == [2.0]


def test_topics_of_the_simulator_come_from_its_own_log(tmp_path):
    log = record(tmp_path / "boat.mcap", m.Tick(t_ns=10, index=0))
    truth = m.GroundTruth(t_ns=20, north_m=1.0, east_m=2.0, psi_rad=0.0, u_m_s=0.0, v_m_s=0.0, r_rad_s=0.0, f_n=(1.0,))
    both = record(tmp_path / "sim.mcap", truth, m.Tick(t_ns=30, index=9))
    found = tables(log, both).by_topic
    assert found["ground_truth"]["f_n_0"].to_list() == [1.0]
    assert found["tick"]["index"].to_list() == [0]


def test_a_log_of_nothing_and_a_damaged_one(tmp_path, drive_log, capsys):
    empty = tmp_path / "empty.mcap"
    Recorder(empty, {}, lambda: 0, wall_offset_ns=0).close()
    with pytest.raises(command.LogError, match="no message in it"):
        command.export_topics(empty, tmp_path / "a", "csv")
    cut = drive_log(10.0)
    cut.write_bytes(cut.read_bytes()[:-20_000])
    assert command.export_topics(cut, tmp_path / "b", "parquet") == log_cli.DAMAGED
    assert "ends without footer" in capsys.readouterr().out
