"""One case as a worker runs it: fits and diagnoses of simulated drives and of logs, and what becomes of errors."""

import pytest

from companion.logs.readers.table import write_run
from sim.campaign import fits
from sim.campaign.inputs import read_campaign
from sim.campaign.mission import unleased
from sim.campaign.runners.worker import program, run_work
from sim.world.teleop_log import teleop_run
from tests.support.campaign_fixture import campaign_file
from tests.support.vessel_fixtures import BOATS, boat

HEAD = """format = 1
name = "fits"
kind = "{kind}"
seeds = [3]
[files]
vessel = "{vessel}"
{more}
"""


def works(folder, kind, more, vessel=BOATS / "aritra.toml"):
    path = folder / "fits.toml"
    path.write_text(HEAD.format(kind=kind, vessel=vessel, more=more))
    inputs, cases = read_campaign(path)
    return [inputs.work(case) for case in cases]


@pytest.mark.long
def test_an_identification_of_a_simulated_drive_is_judged_by_its_truth(tmp_path):
    """Seed 3, 60 s; the true boat has more drag than the file says."""
    more = "[identify]\ndrive_s = 60.0\n[set]\ntruth.damping.X_uu_N_s2_m2 = -15.0"
    (work,) = works(tmp_path, "identify", more)
    outcome = run_work(work)
    assert outcome.error == "", outcome.trace
    f = outcome.figures
    assert f["believe"] == "structured" and f["converged"] is True and f["X_uu_N_s2_m2_true"] == -15.0
    assert abs(f["X_uu_N_s2_m2"] + 15.0) < 4 * f["X_uu_N_s2_m2_se"] < 8.0
    assert f["intervals_that_hold"] > 0.7 and "relative_error_structured" in f
    assert outcome.program == program() and outcome.seconds > 0
    assert run_work(work).figures == f, "the same bits again"


@pytest.mark.parametrize(
    ("said", "V_c_m_s"), [("", 0.2), ("weather.V_c_m_s = 0.05", 0.05), ("weather.V_c_m_s = 0.0", 0.0)]
)
def test_the_true_boats_own_current_flows_where_the_campaign_states_none(tmp_path, monkeypatch, said, V_c_m_s):
    seen = []

    def drive(*_, weather, **__):
        seen.append(weather.V_c_m_s)
        raise ValueError("far enough")

    monkeypatch.setattr(fits, "teleop_run", drive)
    vessel, terms = tmp_path / "boat.toml", '[terms.current]\nV_c_m_s = 0.2\nsource = "assumed"\n'
    vessel.write_text(f"{(BOATS / 'aritra.toml').read_text()}\n{terms}")
    (work,) = works(tmp_path, "identify", f"[identify]\ndrive_s = 60.0\n[set]\n{said}", vessel)
    assert "far enough" in run_work(work).error and seen == [V_c_m_s]


@pytest.mark.long
def test_a_diagnosis_of_a_simulated_drive_names_the_weak_thruster(tmp_path):
    """Seed 3, 120 s; the rear port thruster gives 60 %."""
    more = "[diagnose]\ndrive_s = 120.0\n[set]\ntruth.thrusters.rear_port.gain = 0.6"
    (work,) = works(tmp_path, "diagnose", more)
    outcome = run_work(work)
    assert outcome.error == "", outcome.trace
    f = outcome.figures
    assert (f["verdict"], f["causes"]) == ("named", "thruster_gain:rear_port")
    assert f["thruster_gain:rear_port.gain"] == pytest.approx(0.6, abs=0.05) and f["gain_position"] > 0.3


@pytest.mark.long
def test_a_log_is_read_where_the_work_is_done_and_must_be_the_one_that_was_meant(tmp_path):
    run = teleop_run(boat("aritra"), 3, 60.0)
    write_run(run, tmp_path / "a.parquet")
    (work,) = works(tmp_path, "identify", 'log = "a.parquet"')
    outcome = run_work(work)
    assert outcome.error == "" and outcome.figures["converged"] is True, outcome.trace
    assert not any(name.endswith("_true") for name in outcome.figures)
    (tmp_path / "a.parquet").write_bytes(b"else")
    outcome = run_work(work)
    assert outcome.figures == {} and outcome.error.startswith("ConfigError: ") and "is not what it was" in outcome.error
    assert "Traceback" in outcome.trace
    (tmp_path / "a.parquet").unlink()
    assert "FileNotFoundError" in run_work(work).error


def test_a_mission_that_never_begins_has_no_figures_of_driving(tmp_path):
    """In a second and a half the boat has no position yet."""
    inputs, cases = read_campaign(campaign_file(tmp_path, old="limit_s = 8.0", new="limit_s = 1.5"))
    figures = run_work(inputs.work(cases[0])).figures
    assert figures["finished"] is False and figures["waypoints_missed"] == 2 and figures["simulated_s"] == 1.5
    assert (
        figures["cross_track_rms_m"] is figures["nees"] is figures["plan_share"] is figures["station_error_m"] is None
    )


def test_a_drawn_start_beyond_the_fence_fails_as_a_case(tmp_path):
    inputs, cases = read_campaign(campaign_file(tmp_path, old="[7.5, 8.5]", new="[500.0, 501.0]"))
    assert "beyond the fence" in run_work(inputs.work(cases[0])).error


@pytest.mark.parametrize(
    ("ticks", "leases", "wrong"),
    [([0, 1], [0, 1], False), ([0, 1], [0], False), ([0, 1], [], True), ([0, 1], [1], True), ([0], [0, 0], True)],
)
def test_every_tick_but_an_open_last_one_has_one_lease(ticks, leases, wrong):
    assert unleased(ticks, leases) is wrong
