"""A log of the boat's own program, made on the stepped clock (seed 3), as a run."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from companion.boat.load_run import EXAMPLES, load_setup
from companion.core import messages as m
from companion.core.messages.sensors import GnssFix
from companion.logs.log_file import LogError
from companion.logs.readers.read_run import ReadOptions, read_run
from companion.logs.readers.uwb import read_uwb
from companion.logs.runs.problems import grouped, problems
from companion.logs.runs.run import Run, RunError
from tests.companion.logs.readers.run_logs import WALL_OFFSET_NS, record, simulated
from tests.support.vessel_fixtures import boat

THRUSTERS = ("front_port", "front_starboard", "rear_port", "rear_starboard")


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> Path:
    return record(tmp_path_factory.mktemp("run") / "drive.mcap", simulated())


LINK_S = 0.015  # control.latency_s of the example run file


@pytest.fixture(scope="module")
def run(log: Path) -> Run:
    return read_run(log)


def of(kind) -> list:
    return [x for x in simulated() if isinstance(x, kind)]


def seconds(run: Run, message) -> float:
    return (message.t_ns - run.meta.zero_ns) / 1e9


def test_it_says_how_late_the_autopilots_filters_make_the_imu(run: Run):
    assert run.meta.late_s == {c: pytest.approx(0.01125, abs=1e-5) for c in ("r_rad_s", "ax_m_s2", "ay_m_s2")}


def test_measurements_are_those_of_the_messages(run: Run):
    by_time = dict(zip(run.table["t_s"], run.table.iter_rows(named=True), strict=True))
    samples = of(m.ImuSample)
    assert len(samples) > 700
    for s in samples:
        row = by_time[seconds(run, s)]
        assert (row["r_rad_s"], row["ax_m_s2"], row["ay_m_s2"]) == (s.r_rad_s, s.ax_m_s2, s.ay_m_s2)
    t_s, psi = run.samples("psi_rad")
    attitudes = of(m.Attitude)
    assert len(psi) == len(attitudes)
    np.testing.assert_allclose(t_s, [seconds(run, a) for a in attitudes], atol=1e-3)
    np.testing.assert_allclose(np.cos(psi), [np.cos(a.psi_rad) for a in attitudes], atol=1e-12)
    t_s, places = run.samples("north_m", "east_m")
    fixes = of(m.UwbPosition)
    assert t_s.tolist() == [seconds(run, p) for p in fixes]
    assert places.tolist() == [[p.y_m, p.x_m] for p in fixes]
    cycles = of(m.UwbRanges)
    assert run.samples("range_1151_m")[1].tolist() == [
        r.range_m for c in cycles for r in c.ranges if r.anchor == "1151"
    ]


def test_commands_are_the_leases_held(run: Run):
    assert run.thrusters == THRUSTERS
    leases = of(m.OverrideLease)
    when = np.array([seconds(run, lease) + LINK_S for lease in leases])
    t_s, pwm = run.samples(*(f"pwm_{name}" for name in THRUSTERS))
    held = np.array([leases[i].pwm_us[:4] for i in np.searchsorted(when - 1e-6, t_s, side="right") - 1])
    np.testing.assert_array_equal(pwm, held)
    assert t_s[0] == pytest.approx(when[0], abs=1e-9)


def test_metadata_comes_from_the_files_in_the_log(run: Run):
    meta = run.meta
    assert (meta.vessel, meta.site, meta.source, meta.clock) == (
        "aritra",
        "basin",
        "drive.mcap",
        "companion, monotonic",
    )
    assert meta.latency_s == 0.08
    assert meta.tag_arm_m == (-0.2, 0.0)
    assert meta.anchors_m["111C"] == (30.0, 30.0, -2.5)
    assert meta.pwm_limits_us == dict.fromkeys(THRUSTERS, (1100.0, 1900.0))
    assert meta.notes == ()


def test_truth_in_the_log_or_beside_it(run: Run, tmp_path):
    truths = of(m.GroundTruth)
    inside = [t for t in truths if 0 <= seconds(run, t) <= run.duration_s]
    assert run.samples("true_u_m_s")[1].tolist() == [t.u_m_s for t in inside]
    assert run.samples("true_f_rear_port_n")[1].tolist() == [t.f_n[2] for t in inside]
    apart = record(tmp_path / "a.mcap", [x for x in simulated() if not isinstance(x, m.GroundTruth)])
    beside = record(tmp_path / "truth.mcap", truths)
    assert not read_run(apart).known("true_u_m_s")
    joined = read_run(apart, ReadOptions(truth=beside))
    assert joined.table.equals(run.table)


def test_the_truth_of_another_run_is_refused(log: Path, tmp_path, monkeypatch):
    """Stepped clocks all begin at 0, so that any two logs would overlap."""
    monkeypatch.setattr("tests.companion.logs.readers.run_logs.WALL_OFFSET_NS", WALL_OFFSET_NS - 86_400 * 10**9)
    other = record(tmp_path / "truth.mcap", of(m.GroundTruth))
    with pytest.raises(LogError, match=r"truth\.mcap: is of another run than .*drive\.mcap"):
        read_run(log, ReadOptions(truth=other))


def test_a_simulated_run_has_no_problem(run: Run):
    """The tag's first range and the pilot's first thrust come within the 5 s from which on silence is one."""
    assert not problems(run)


def test_a_vessel_file_in_another_order_gives_every_thruster_its_own_pulses_and_forces(run: Run, log: Path):
    aritra = boat("aritra")
    turned = read_run(log, ReadOptions(vessel=replace(aritra, thrusters=aritra.thrusters[::-1])))
    assert turned.thrusters == THRUSTERS[::-1]
    assert turned.table.select(run.table.columns).equals(run.table)
    assert turned.meta.notes == ()


def test_another_boats_vessel_file_is_refused_with_both_wirings(log: Path):
    aritra, port = boat("aritra"), "front_port on channel 9"
    moved = (replace(aritra.thrusters[0], channel=13), *aritra.thrusters[1:])
    for other, said in (
        (boat("twin"), "that of twin port on channel 9, starboard on channel 10: another boat's log"),
        (replace(aritra, thrusters=moved), "that of aritra front_port on channel 13, .*another boat's vessel file"),
    ):
        with pytest.raises(RunError, match=rf"drive\.mcap: the vessel file in it \(aritra\) has {port}, .*{said}"):
            read_run(log, ReadOptions(vessel=other))


def test_a_lease_that_ran_out_is_followed_by_neutral(tmp_path):
    kept = [x for x in simulated() if not (isinstance(x, m.OverrideLease) and 100 <= x.index < 110)]
    run = read_run(record(tmp_path / "a.mcap", kept))
    last, following = (next(x for x in of(m.OverrideLease) if x.index == i) for i in (99, 110))
    t_s, pwm = run.samples("pwm_front_port")
    end_s = seconds(run, last) + LINK_S + last.valid_for_s - 1e-6
    again_s = seconds(run, following) + LINK_S - 1e-6
    silent = (t_s >= end_s) & (t_s < again_s)
    assert set(pwm[silent]) == {1500.0}
    assert 30 < silent.sum() < 60
    before = (t_s >= seconds(run, last) + LINK_S - 1e-6) & (t_s < end_s)
    assert set(pwm[before]) == {float(last.pwm_us[0])}


def test_what_the_autopilot_did_not_obey_is_told(tmp_path):
    def stopped(x):
        held = isinstance(x, m.ServoOutput) and 10e9 < x.t_ns - of(m.Tick)[0].t_ns < 13e9
        return replace(x, pwm_us=(1500,) * 16) if held else x

    found = grouped(problems(read_run(record(tmp_path / "a.mcap", [stopped(x) for x in simulated()]))))
    (p,) = found["not obeyed"]
    assert p.t_s == pytest.approx(10.0, abs=0.7)
    assert p.length_s == pytest.approx(2.9, abs=0.7)


def functions(first: int, *values: float) -> list[m.ParamValue]:
    """SERVOn_FUNCTION of so many outputs from `first` on, logged at the start."""
    t_ns = of(m.Tick)[0].t_ns
    return [
        m.ParamValue(t_ns=t_ns, name=f"SERVO{n}_FUNCTION", value=value, count=0, index=0)
        for n, value in enumerate(values, first)
    ]


@pytest.mark.parametrize("values", [(59.0, 60.0, 61.0, 62.0), (94.0, 95.0, 96.0, 97.0)])
def test_outputs_are_compared_by_their_functions(tmp_path, values):
    """Thrusters on outputs 5 to 8, as RC channels passed on or by the gate's script."""

    def moved(x, stuck: bool = False):
        return replace(x, pwm_us=(*[1500] * 4, *([1500] * 4 if stuck else x.pwm_us[:4]), *[0] * 8))

    def read(name: str, change):
        changed = [change(x) if isinstance(x, m.ServoOutput) else x for x in simulated()]
        return grouped(read_run(record(tmp_path / name, [*functions(5, *values), *changed])).meta.notes)

    assert read("a.mcap", moved) == {}
    assert set(read("b.mcap", partial(moved, stuck=True))) == {"not obeyed"}


def test_outputs_of_unknown_functions_say_nothing_of_obedience(tmp_path):
    """A mixer's motors: what they should put out does not stand in the leases."""
    still = [replace(x, pwm_us=(1500,) * 16) if isinstance(x, m.ServoOutput) else x for x in simulated()]
    assert "not obeyed" in grouped(read_run(record(tmp_path / "a.mcap", still)).meta.notes)
    mixed = [*functions(1, 33.0, 34.0, 35.0, 36.0), *still]
    assert read_run(record(tmp_path / "b.mcap", mixed)).meta.notes == ()


def test_positions_from_ranges_where_the_tag_gives_none(run: Run, tmp_path):
    only = read_run(record(tmp_path / "a.mcap", [x for x in simulated() if not isinstance(x, m.UwbPosition)]))
    t_s, places = only.samples("north_m", "east_m")
    assert "least squares" in only.meta.columns["north_m"]
    own_t, own = run.samples("north_m", "east_m")
    assert t_s.tolist() == own_t.tolist()
    assert np.linalg.norm(places - own, axis=1).max() < 0.15  # the tag solves plain least squares on the same ranges


def test_of_two_sources_of_positions_the_vessel_files_counts(run: Run, tmp_path):
    """Fixes at the site's origin, each 1 ms after a position of the tag."""
    site = load_setup(EXAMPLES / "aritra.toml").pilot.site
    place = {"fix_type": 6, "lat_deg": site.lat_deg, "lon_deg": site.lon_deg, "h_acc_m": 0.02}
    fixes = [GnssFix(t_ns=p.t_ns + 1_000_000, t_rx_ns=p.t_rx_ns, **place) for p in of(m.UwbPosition)]
    path = record(tmp_path / "both.mcap", sorted((*simulated(), *fixes), key=lambda x: x.t_ns))
    by_gnss = read_run(path, ReadOptions(vessel=boat("lake")))
    t_s, places = by_gnss.samples("north_m", "east_m")
    np.testing.assert_allclose(t_s, [seconds(by_gnss, fix) for fix in fixes], atol=1e-9)
    np.testing.assert_allclose(places, 0.0, atol=1e-3)
    assert by_gnss.meta.columns["north_m"] == "GNSS, position"
    assert [(p.kind, "UWB" in p.text, "GNSS" in p.text) for p in by_gnss.meta.notes] == [("left out", True, True)]
    by_tag = read_run(path, ReadOptions(vessel=boat("aritra")))
    assert by_tag.samples("north_m")[1].tolist() == run.samples("north_m")[1].tolist()
    assert by_tag.meta.notes == ()


def test_a_log_without_files_names_thrusters_by_channel(tmp_path):
    run = read_run(record(tmp_path / "a.mcap", simulated(), files=False))
    assert run.thrusters == ("ch9", "ch10", "ch11", "ch12")
    assert run.meta.latency_s is None
    setup = load_setup(EXAMPLES / "aritra.toml").pilot
    told = read_run(tmp_path / "a.mcap", ReadOptions(vessel=setup.vessel, site=setup.site))
    assert told.thrusters == THRUSTERS
    assert told.meta.site == "basin"


def with_a_key_of_another_version(text: str) -> str:
    return "key_of_another_version = 1\n" + text


def test_a_file_in_the_log_that_this_version_refuses_is_noted_with_what_it_costs(run: Run, tmp_path):
    path = record(tmp_path / "a.mcap", simulated(), run=with_a_key_of_another_version)
    (p,) = grouped(problems(read_run(path)))["configuration"]
    assert "a.mcap: run.toml: key_of_another_version" in p.text and "control.latency_s" in p.text
    path = record(tmp_path / "b.mcap", simulated(), vessel=with_a_key_of_another_version)
    by_channel = read_run(path)
    (p,) = grouped(problems(by_channel))["configuration"]
    assert "b.mcap: vessel.toml: key_of_another_version" in p.text and "RC channels" in p.text
    assert by_channel.thrusters == ("ch9", "ch10", "ch11", "ch12")
    beside = read_run(path, ReadOptions(vessel=boat("aritra")))
    assert beside.meta.notes == () and beside.table.equals(run.table)


def test_a_site_file_in_the_log_that_this_version_refuses_needs_another(run: Run, tmp_path):
    path = record(tmp_path / "a.mcap", simulated(), site=with_a_key_of_another_version)
    with pytest.raises(RunError, match=r"a\.mcap: site\.toml: key_of_another_version.*--site"):
        read_run(path)
    site = load_setup(EXAMPLES / "aritra.toml").pilot.site
    assert read_run(path, ReadOptions(site=site)).table.equals(run.table)


def test_damage_is_told(log: Path, tmp_path):
    path = tmp_path / "cut.mcap"
    path.write_bytes(log.read_bytes()[:-60_000])
    (p,) = grouped(problems(read_run(path)))["damaged"]
    assert "cut.mcap" in p.text


def test_several_inertial_sources_are_told(tmp_path):
    mixed = [
        replace(x, source="SCALED_IMU") if isinstance(x, m.ImuSample) and x.r_rad_s > 0 else x for x in simulated()
    ]
    assert "mixed" in grouped(problems(read_run(record(tmp_path / "a.mcap", mixed))))


def test_logs_without_what_is_needed_are_refused(tmp_path):
    path = record(tmp_path / "a.mcap", of(m.ImuSample))
    with pytest.raises(RunError, match=r"a\.mcap: no thruster commands"):
        read_run(path)
    with pytest.raises(LogError, match=r"absent\.mcap: no such file"):
        read_run(tmp_path / "absent.mcap")
    with pytest.raises(RunError, match=r"a\.mcap: no UWB measurement"):
        read_uwb(path, None, None, 0.0, 0)


def test_the_uwb_of_a_log_alone_is_on_the_unix_clock(log: Path):
    (ranges, positions) = read_uwb(log, None, None, 0.0, 0).streams
    assert positions.t_ns.tolist() == [p.t_ns + WALL_OFFSET_NS for p in of(m.UwbPosition)]
    assert ranges.outside and positions.outside
