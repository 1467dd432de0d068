"""Excitations for tests: a hypothesis strategy, and a quick flight in the plant without sensors or wires."""

from dataclasses import dataclass

import numpy as np
from hypothesis import strategies as st

from companion.boat.load_run import EXAMPLES
from companion.core.configuration.site_file import Site, load_site
from companion.core.control.allocation import pulse_widths
from companion.core.excitation.file import (
    Excitation,
    Idle,
    Multisine,
    Opposed,
    Pulses,
    Steps,
    Zigzag,
    load_excitation,
)
from companion.core.excitation.flight import BEGINNING, Flight
from companion.core.geometry.fence import ANYWHERE
from companion.core.messages import ExcitationStatus
from sim.world.environment import Environment, Weather
from sim.world.plant import Plant, perturbed
from tests.support.vessel_fixtures import boat

TICK_NS, STEP_NS = 100_000_000, 10_000_000
LIBRARY = load_excitation((EXAMPLES / "excitations" / "library.toml").read_text(), name="library.toml")
BASIN = load_site((EXAMPLES / "sites" / "basin.toml").read_text(), name="basin.toml")

share = st.floats(-1, 1).map(lambda x: round(x, 4))
seconds = st.floats(0.1, 600).map(lambda x: round(x, 3))
levels = st.lists(share, min_size=1, max_size=6).map(tuple)
amplitude = st.floats(0.01, 1).map(lambda x: round(x, 4))
text = st.text(min_size=1, max_size=20)
steps = st.builds(Steps, name=text, why=text, X=amplitude, Y=share, N=share, levels=levels, hold_s=seconds)
segments = st.one_of(
    steps,
    st.builds(Zigzag, name=text, X=share, N=amplitude, switch_deg=st.floats(1, 90), duration_s=seconds),
    st.builds(
        Multisine, name=text, X=amplitude, Y=amplitude, N=amplitude,
        period_s=st.floats(10, 120), f_max_Hz=st.floats(0.4, 2), periods=st.integers(1, 5),
    ),
    st.builds(Pulses, name=text, levels=levels, on_s=seconds, off_s=seconds),
    st.builds(Opposed, name=text, levels=levels, hold_s=seconds),
    st.builds(Idle, name=text, duration_s=seconds),
)  # fmt: skip
excitations = st.builds(
    Excitation, format=st.just(1), name=text, margin_m=st.floats(0, 5), return_m=st.floats(0.5, 5),
    return_speed_m_s=st.floats(0.1, 1), segments=st.lists(segments, min_size=1, max_size=4).map(tuple),
)  # fmt: skip
feasible = st.builds(
    lambda pushes, hold_s, margin_m: of(
        *(
            Steps(name="push", X=x, Y=y, N=1 - abs(x) - abs(y), levels=(1.0, -1.0), hold_s=hold_s)
            for x, y in ((0.5 * a + 0.5 * b, 0.5 * a - 0.5 * b) for a, b in pushes)
        ),
        margin_m=margin_m,
    ),
    pushes=st.lists(st.tuples(st.floats(-0.9, 0.9), st.floats(-0.9, 0.9)), min_size=1, max_size=3),
    hold_s=st.floats(2, 20),
    margin_m=st.floats(0.5, 3),
)
"""Forces on the edge of what is within reach: shares whose sizes add up to 1, for the reachable set is convex."""


def square(side_m: float) -> Site:
    fence = ((0.0, 0.0), (side_m, 0.0), (side_m, side_m), (0.0, side_m))
    return Site(name="square", lat_deg=0.0, lon_deg=0.0, fence=fence, source="assumed")


def of(*segments, **keys) -> Excitation:
    return Excitation(format=1, name="test", segments=segments, **keys)


@dataclass(frozen=True)
class Flown:
    t_s: np.ndarray
    x: np.ndarray
    f_n: np.ndarray
    statuses: list[ExcitationStatus]
    notes: list[str]
    clearance_m: float


def flown(
    excitation,
    *,
    site=BASIN,
    name="aritra",
    seed=0,
    share=0.0,
    weather=None,
    error_m=0.0,
    limit_s=400.0,
    eta=None,
    others=ANYWHERE,
    period_s=TICK_NS * 1e-9,
):
    """Flight of a boat off the file by up to `share`, told a place that wanders by `error_m` (one sigma)."""
    vessel, rng = boat(name), np.random.default_rng(seed)
    true = perturbed(vessel, rng, share) if share else vessel
    flight = Flight(excitation, vessel, site, name="test.toml", others=others, period_s=period_s)
    start = (*flight.pen.middle, rng.uniform(-3, 3)) if eta is None else eta
    plant = Plant(true, np.array([*start, 0, 0, 0]), step_ns=STEP_NS, voltage_v=15.6)
    world = Environment(weather or Weather(), rng)
    state, rows, statuses, notes, error = BEGINNING, [], [], [], np.zeros(2)
    while not flight.is_over(state) and plant.motion.t_ns < limit_s * 1e9:
        t_ns, x = plant.motion.t_ns, plant.motion.x
        if t_ns % round(period_s * 1e9) == 0:
            error = 0.98 * error + np.sqrt(1 - 0.98**2) * error_m * rng.normal(size=2)
            told = np.array([*(x[:2] + error), x[2]])
            state, f, note = flight.step(state, told, x[3:6], t_ns, spread_m=2 * error_m)
            statuses.append(flight.status(state, t_ns))
            notes += [note] if note else []
            rows.append((t_ns * 1e-9, x.copy(), f))
            plant.command(t_ns + 30_000_000, tuple(map(float, pulse_widths(f, vessel, plant.voltage_v))))
        plant.step(world.step(t_ns * 1e-9, STEP_NS * 1e-9))
    t, xs, fs = (np.array(column) for column in zip(*rows, strict=True))
    return Flown(t, xs, fs, statuses, notes, float(flight.pen.clearance(xs[:, :2]).min()))
