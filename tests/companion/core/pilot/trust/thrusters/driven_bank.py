"""The thruster bank and its judge on residuals of a boat that is driven by random forces, without a filter."""

import numpy as np
from msgspec.structs import replace

from companion.core.model.manoeuvring import mass_matrix
from companion.core.model.thrusters import configuration_matrix
from companion.core.pilot.monitors.monitor import TickView
from companion.core.pilot.trust.thrusters.hypothesis_bank import NOISE, ThrusterBank
from companion.core.pilot.trust.thrusters.remaining_thrust import RemainingThrust, ThrusterHealth
from companion.core.pilot.trust.thrusters.thruster_monitor import ThrusterMonitor
from companion.core.pilot.trust.thrusters.thruster_verdict import ThrusterVerdicts
from tests.support.drive_fixture import setup

VESSEL = setup().pilot.vessel
B, M = configuration_matrix(VESSEL), mass_matrix(VESSEL)
REMAINING, MONITOR, BANK = RemainingThrust(VESSEL), ThrusterMonitor(VESSEL), ThrusterBank(B, M)
VERDICTS = ThrusterVerdicts(VESSEL, BANK)


def believing(force_n):
    """What is known where thruster 0 is believed to stick at this force [N]."""
    health = ThrusterHealth((1.0,) * 4, (force_n, None, None, None), (0, 1, 2, 3))
    return replace(MONITOR.initial, bank=VERDICTS.initial(health), health=health)


def driven(state, first_n, seconds, seed=5, push=lambda t_s: 0.0, alerts=None, **seen):
    """After so long, or at `crippled`; thruster 0 really gives `first_n` [N], of what it is told or a number.

    `push`: another wrench [N, N, N m] at a time [s]; `alerts`: a list to which (time, text) are added; `seen`: fields
    of TickView.
    """
    rng, f = np.random.default_rng(seed), np.zeros(4)
    for k in range(10 * seconds):
        t_ns = k * 100_000_000
        f = f + 0.1 * (rng.normal(0, 15, 4) - f)
        told = REMAINING.redistribute(f + (REMAINING.probe(t_ns) if state.probing else 0.0), state.health)
        real_n = first_n(told[0]) if callable(first_n) else first_n
        residual = B[:, 0] * (real_n - told[0]) + rng.normal(0, NOISE) + push(t_ns * 1e-9)
        bank = VERDICTS.bank(state.health).step(state.bank, residual, told, np.linalg.solve(M, B @ told)[:2], 0.1)
        if t_ns >= state.quiet_until_ns:
            view = TickView(t_ns, 0, None, 0, True, driving=True, **seen)
            state, report = VERDICTS.judge(replace(state, bank=bank), view)
            if alerts is not None:
                alerts.extend((t_ns * 1e-9, a.text) for a in report.alerts)
        if state.hopeless:
            break
    return replace(state, quiet_until_ns=0)
