"""A sound boat in the weather of the false alarms: current, gusts, waves, reflections, dropouts, an imperfect model."""

import numpy as np

from sim.world.environment import Weather
from sim.world.sensors import UwbFaults
from tests.fault_lab.trial import Verdict, trial

ROUND_S = 300.0
WAVES_M = (0.0, 0.1, 0.2)


def sound_in_weather(seed: int, duration_s: float = ROUND_S) -> Verdict:
    """One round: directions and waves by the seed; hull and thrusters off by 20 %, UWB at 1 Hz."""
    rng = np.random.default_rng([seed, 99])
    towards, wind_from = rng.uniform(0, 360, 2)
    weather = Weather(
        V_c_m_s=0.15, beta_c_deg=towards, V_w_m_s=5.0, beta_w_deg=wind_from, gustiness=0.3,
        H_s_m=float(rng.choice(WAVES_M)), T_p_s=float(rng.uniform(1.6, 2.6)),
    )  # fmt: skip
    faults = UwbFaults(dropout=0.1, nlos=0.05)
    return trial(seed, weather=weather, duration_s=duration_s, mismatch=0.2, faults=faults)
