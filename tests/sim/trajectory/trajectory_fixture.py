"""Pulse widths, and the plant stepped one by one, for the tests of whole trajectories."""

import numpy as np
import pytest
from msgspec.structs import replace

from companion.jit import machine
from sim.trajectory import Surroundings
from tests.support.vessel_fixtures import boat

llvm = pytest.importorskip("llvmlite.binding", reason="llvmlite is not installed")
if not machine.may_run_what_was_written():
    pytest.skip("the system forbids machine code", allow_module_level=True)
VESSEL = boat("aritra")
DT = 0.01
START = np.array([1.0, -2.0, 0.4, 0.5, -0.1, 0.3])


def pulses(count, n=4, seed=1, hold=10):
    """Pulse widths that change every `hold` samples, beyond the ESC's range too."""
    rng = np.random.default_rng(seed)
    return np.repeat(rng.integers(1050, 1950, (-(-count // hold), n)), hold, axis=0)[:count]


def extended():
    """A boat with everything that a vessel file may have."""
    p = replace(VESSEL.propulsion, slew_N_s=90.0, advance_loss_sqrt_N_s_m=0.4)
    terms = {"speed_damping": {"N_ur_N_s2": -3.0}, "munk_moment": {"k_kg": 2.0},
             "tether": {"north_m": 1.0, "stiffness_N_m": 2.0, "slack_m": 0.5},
             "shallow_zone": {"radius_m": 2.0, "share": 0.5}}  # fmt: skip
    first = replace(VESSEL.thrusters[0], gain=0.7, trim_us=12)
    return replace(VESSEL, propulsion=p, terms=terms, thrusters=(first, *VESSEL.thrusters[1:]))


def mixed(m, count=120):
    """Arguments of m different trajectories."""
    rng = np.random.default_rng(m)
    pwm = np.stack([pulses(count, seed=i) for i in range(m)])
    around = Surroundings(rng.uniform(0, 0.3, (m, 1)), 30.0, rng.uniform(0, 8, (m, count)), 200.0)
    numbers = {"inertia.mass_kg": rng.uniform(35, 60, m), "thrusters.rear_port.gain": rng.uniform(0.2, 1.2, m)}
    volts = rng.uniform(13, 16, (m, 1))
    return START + rng.normal(size=(m, 6)), pwm, around, numbers, volts
