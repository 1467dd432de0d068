"""The bank on residuals of a known boat: it names what was done to it, and nothing where nothing was. Seed 5."""

import numpy as np
import pytest

from companion.core.model.manoeuvring import mass_matrix
from companion.core.model.thrusters import configuration_matrix
from companion.core.pilot.trust.thrusters.hypothesis_bank import (
    AXES,
    MEMORY_S,
    NOISE,
    NOISE_TICKS,
    ThrusterBank,
    ThrustHypothesis,
    hypotheses,
)
from companion.core.pilot.trust.thrusters.thruster_verdict import AHEAD_NATS, SURE_NATS
from tests.support.drive_fixture import setup

VESSEL = setup().pilot.vessel
B, M = configuration_matrix(VESSEL), mass_matrix(VESSEL)


def told(spoil, seconds=60.0, seed=5, thrust=False):
    """Where the sums are largest: hypothesis, nats, its mean; after residuals `spoil(f)` that a fault leaves.

    `thrust`: of the hypotheses on thrusters alone.
    """
    rng, bank = np.random.default_rng(seed), ThrusterBank(B, M)
    state, f, best = bank.initial(), np.zeros(4), (bank.hypotheses[0], 0.0, np.zeros(8))
    for _ in range(round(10 * seconds)):
        f = f + 0.1 * (rng.normal(0, 40, 4) - f)
        state = bank.step(state, spoil(f) + rng.normal(0, NOISE), f, felt(f), 0.1)
        k = int(
            np.argmax([n * (not thrust or h.blames_thrust) for n, h in zip(state.nats, bank.hypotheses, strict=True)])
        )
        if state.nats[k] > best[1]:
            best = bank.hypotheses[k], float(state.nats[k]), state.mean[k]
    return best


def felt(f):
    """What the accelerometer feels [m/s^2] of a boat that begins to move."""
    return np.linalg.solve(M, B @ f)[:2]


def gain(i, share):
    return lambda f: (share - 1.0) * f[i] * B[:, i]


@pytest.mark.parametrize(
    ("spoil", "kind", "i"),
    [
        (gain(0, 0.0), "gain", 0),
        (gain(1, -1.0), "gain", 1),
        (lambda f: (20.0 - f[2]) * B[:, 2], "stuck", 2),
        (lambda f: (f[1] - f[0]) * (B[:, 0] - B[:, 1]), "swap", 0),
        (lambda f: -2.0 * B @ f, "reversed", -1),
    ],
)
@pytest.mark.long
def test_it_names_what_was_done(spoil, kind, i):
    hypothesis, nats, mean = told(spoil)
    assert (hypothesis.kind, hypothesis.i) == (kind, i) and nats > 15.0
    if kind == "gain":
        assert mean[3 + i] == pytest.approx(-1.0 if i == 0 else -2.0, abs=0.3)


@pytest.mark.parametrize("i", range(len(AXES)))
def test_an_accelerometer_with_turned_axes_is_no_thruster(i):
    hypothesis, nats, _ = told(lambda f: M[:, :2] @ (AXES[i] - np.eye(2)) @ felt(f), 10.0)
    assert hypothesis == ("askew", i, -1) and nats > 15.0


def test_a_push_and_a_bad_accelerometer_are_no_thruster():
    for wrench in (M @ [0.8, -0.4, 0.0], np.array([40.0, 0.0, 6.0])):
        hypothesis, nats, _ = told(lambda f, w=wrench: w, 5.0)
        assert hypothesis.kind in ("accel", "pushed") and nats > 8.0


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.long
def test_a_sound_boat_with_thrusters_off_and_a_wind_is_not_accused(seed):
    rng = np.random.default_rng([seed, 1])
    shares, wind = rng.uniform(0.8, 1.2, 4), rng.normal(0, 2, 3) * (1.0, 1.0, 0.3)
    _, nats, _ = told(lambda f: B @ ((shares - 1.0) * f) + wind, 60.0, seed)
    assert nats < 8.0


def test_waves_are_noise_and_no_thruster():
    t = iter(np.arange(0, 1000, 0.1))
    _, nats, _ = told(lambda f: np.array([20.0, 30.0, 5.0]) * np.sin(3.1 * next(t) + np.arange(3)), thrust=True)
    assert nats < 15.0


@pytest.mark.long
@pytest.mark.parametrize("seed", range(6))
def test_commands_that_answer_waves_blame_no_thruster(seed):
    """Thrusters that are off by 20 % follow what waves did 0.3 s ago."""
    rng, bank = np.random.default_rng([seed, 2]), ThrusterBank(B, M)
    phase, omega = rng.uniform(0, 6, (8, 3)), rng.uniform(2.4, 3.9, (8, 1))
    shares, steady = rng.uniform(0.8, 1.2, 4), rng.normal(0, 8, 4)
    state, answer, most = bank.initial(), -0.7 * np.linalg.pinv(B), 0.0
    for k in range(1800):
        wave, before = (
            np.sum((5.0, 5.0, 1.2) * np.sin(omega * t_s + phase), axis=0) for t_s in (0.1 * k, 0.1 * k - 0.3)
        )
        f = steady + answer @ before + rng.normal(0, 0.5, 4)
        w = wave + B @ ((shares - 1.0) * f) + rng.normal(0, NOISE) / 2
        state = bank.step(state, w, f, felt(f), 0.1)
        most = max(most, *(n for n, h in zip(state.nats, bank.hypotheses, strict=True) if h.blames_thrust))
    assert most < SURE_NATS


@pytest.mark.parametrize(("wave_n", "kept"), [(0.0, 1.0), (20.0, np.exp(-60.0 / MEMORY_S))])
def test_in_waves_what_spoke_for_a_fault_is_forgotten_where_nothing_more_does(wave_n, kept):
    """No thrust for a minute, which tells nothing of a gain."""
    bank, rng = ThrusterBank(B, M), np.random.default_rng(4)
    k = bank.hypotheses.index(ThrustHypothesis("gain", 0))
    state = bank.initial()
    for tick in range(630):
        w = np.array([wave_n, wave_n, wave_n / 4]) * np.sin(0.3 * tick) + rng.normal(0, 0.8 * np.array(NOISE))
        state = bank.step(state, w, np.zeros(4), np.zeros(2), 0.1)
        if tick == NOISE_TICKS:
            state.nats[k] = 10.0
    assert state.nats[k] == pytest.approx(10.0 * kept, rel=0.02)


@pytest.mark.long
def test_covariances_stay_covariances_in_twenty_minutes_of_waves_that_come_and_go():
    rng, bank = np.random.default_rng(9), ThrusterBank(B, M)
    state = bank.initial()
    for k in range(12_000):
        height, f = max(0.0, np.sin(0.002 * k)), rng.normal(0, 20, 4)
        w = height * np.array([30.0, 30.0, 6.0]) * np.sin(0.3 * k + np.arange(3)) + rng.normal(0, NOISE)
        state = bank.step(state, w, f, felt(f), 0.1)
    np.testing.assert_array_equal(state.P, state.P.transpose(0, 2, 1))
    assert np.linalg.eigvalsh(state.P).min() > -1e-9 * state.P.max()


def test_a_thruster_that_is_dead_from_the_beginning_is_not_lost_among_what_is_taken_for_noise():
    hypothesis, nats, mean = told(gain(3, 0.0), 6.0)
    assert hypothesis == ("gain", 3, -1) and nats > SURE_NATS and mean[6] == pytest.approx(-1.0, abs=0.3)


def test_a_fault_that_begins_late_is_found_within_seconds():
    bank, rng = ThrusterBank(B, M), np.random.default_rng(3)
    state, f = bank.initial(), np.zeros(4)
    for k in range(700):
        f = f + 0.1 * (rng.normal(0, 20, 4) - f)
        w = gain(3, -1.0)(f) if k >= 600 else np.zeros(3)
        state = bank.step(state, w + rng.normal(0, NOISE), f, felt(f), 0.1)
        if k == 599:
            assert state.nats.max() < 8.0
    best = bank.hypotheses[int(np.argmax(state.nats))]
    assert (best.kind, best.i) == ("gain", 3) and state.nats.max() > 15.0


def test_every_boat_has_its_hypotheses():
    assert [h.kind for h in hypotheses(1)] == ["sound", "gain", "stuck", "pushed", "accel", *["askew"] * 4]
    assert len(hypotheses(4)) == 1 + 4 + 4 + 6 + 1 + 2 + 4


@pytest.mark.parametrize("seed", range(5))
def test_a_thruster_that_spins_up_and_sticks_is_told_from_a_bad_accelerometer_within_a_second(seed):
    rng, bank, f = np.random.default_rng(seed), ThrusterBank(B, M), np.array([2.0, 1.0, 1.0, 2.0])
    state = bank.initial()
    for k in range(31):
        stuck_n = f[2] if k < 20 else 45.0 - 44.0 * np.exp(-(k - 19) * 0.1 / 0.15)
        state = bank.step(state, (stuck_n - f[2]) * B[:, 2] + rng.normal(0, NOISE), f, felt(f), 0.1)
    nats = {h: n for h, n in zip(bank.hypotheses, state.nats, strict=True) if h.kind != "pushed"}
    stuck = nats.pop(ThrustHypothesis("stuck", 2))
    assert stuck >= SURE_NATS and stuck - max(nats.values()) >= AHEAD_NATS
