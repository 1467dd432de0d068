"""What the report of a commissioning shows."""

from types import SimpleNamespace
from typing import cast

import numpy as np
from msgspec.structs import replace

from companion.boat.load_run import EXAMPLES
from companion.boat.recorder import Recorder
from companion.core.configuration.site_file import load_site
from companion.core.messages import StateEstimate
from sim.commission.job import CommissionOutcome
from sim.commission.journal import LOG, FlightJournal
from sim.commission.report import person, tracks
from sim.fitting.wiring.record import WiringFinding, WiringReport
from tests.support.vessel_fixtures import boat


def test_tracks_are_broken_where_the_boat_did_not_know_its_place(tmp_path):
    site = load_site((EXAMPLES / "sites" / "basin.toml").read_text(encoding="utf-8"), name="basin")
    flight = tmp_path / "01-pulses"
    flight.mkdir()
    known = [True, True, False, False, True, True]
    with Recorder(flight / LOG, {}, lambda: 0, wall_offset_ns=0) as recorder:
        for k, knows in enumerate(known):
            recorder.record(StateEstimate(
                t_ns=k * 10**8, north_m=float(k), east_m=0.0, psi_rad=0.0, u_m_s=0.0, v_m_s=0.0, r_rad_s=0.0,
                covariance=(0.0,) * 36, accel_bias_m_s2=(0.0, 0.0), gyro_bias_rad_s=0.0, anchor_bias_m={},
                disturbance_n=(0.0,) * 3, health="healthy" if knows else "lost", reason="",
            ))  # fmt: skip
    figure = tracks(cast("FlightJournal", SimpleNamespace(flights=lambda: [flight])), site)
    drawn = np.asarray(figure.axes[0].get_lines()[-1].get_ydata(), dtype=float)
    assert np.isfinite(drawn).tolist() == known


def test_a_compass_that_errs_by_how_the_boat_is_turned_is_told_once_and_only_beyond_the_first_file():
    def iron(cos_rad: float):
        aritra = boat("aritra")
        imu = replace(aritra.sensors.imu, hard_iron_cos_rad=cos_rad)
        return replace(aritra, sensors=replace(aritra.sensors, imu=imu))

    def told(first: float, new: float, fit: object) -> list[str]:
        of_the_check = WiringFinding(
            name="compass:hard_iron", text="the heading errs by up to 8 degrees", certain=False, advice="calibrate"
        )
        belief = SimpleNamespace(
            first=iron(first), vessel=iron(new), fit=fit, wiring=WiringReport(findings=(of_the_check,), logs=2)
        )
        return [line for line in person(cast("CommissionOutcome", SimpleNamespace(belief=belief))) if "errs" in line]

    fit = SimpleNamespace(heading_offset_rad=0.0)
    (line,) = told(0.0, 0.14, fit)
    assert "up to 8 degrees, by how the boat is turned, beyond what the first file has" in line
    assert told(0.14, 0.15, fit) == []
    (before,) = told(0.14, 0.14, None)  # nothing was fitted: the check's own word
    assert before.startswith("Look: perhaps the heading errs")
