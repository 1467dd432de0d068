"""What the report of a commissioning shows."""

from types import SimpleNamespace
from typing import cast

import numpy as np

from companion.boat.load_run import EXAMPLES
from companion.boat.recorder import Recorder
from companion.core.configuration.site_file import load_site
from companion.core.messages import StateEstimate
from sim.commission.journal import LOG, FlightJournal
from sim.commission.report import tracks


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
