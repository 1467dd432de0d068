"""Effects of propulsion: thrusters, speed controllers, battery. f: thruster forces (W, k, n) [N]; tau = B f."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import combinations

import numpy as np
from msgspec.structs import replace

from companion.core.configuration.vessel_file import RotorCurve, RotorMap, VesselFile
from companion.core.model.effects.advance_loss import advanced
from companion.core.model.effects.wash import Jet, jet_sign, washed
from sim.fitting.diagnose.catalogue.effect import Effect, EffectParameter, Hook, Scene, Values
from sim.fitting.diagnose.catalogue.parts import moving, scalar_parameter, share_parameter

TRIM_US = 2.0  # sigma of a speed controller's neutral; assumed
BEND = 0.06  # sigma of how thrust maps are bent, ahead against astern; assumed: 2 % of full thrust at 60 % command
ROOM = 0.99  # share of the way to a map whose second term would be negative, which no vessel file may hold
WHOLE = 0.02  # sigma of the share of commands that two swapped thrusters exchange, of mean 1; assumed
STARTS = 13  # onsets between one entry's neighbours from which a fit may start; assumed
WASH_N = 30.0  # thrust of the thruster ahead at which the loss is stated; assumed
Onset = tuple[float, float]
"""Start of the search for an onset on the shared clock, and half the width of the interval round it [s]."""


def effects(vessel: VesselFile, onsets: tuple[Onset, ...]) -> Iterator[Effect]:
    """Entries of propulsion that can be named; `onsets`: starts of the search for the onset of fouling."""
    names = [t.name for t in vessel.thrusters]
    for i, name in enumerate(names):
        yield Effect(
            f"thruster_gain:{name}",
            "propulsion",
            "f_i (1 + gain)",
            "pulls to one side in proportion to this thruster's command",
            scalar_parameter("gain", "1", 0.5, 0.05, -3.0, 2.0),
            _scaled(vessel, lambda p: 1 + p["gain"], i),
        )
        for onset_s, reach_s in onsets:
            yield _fouling(i, name, onset_s, partial(_between, i, name, onset_s, reach_s))
    for i, j in combinations(range(len(names)), 2):
        yield Effect(
            f"swapped_pair:{names[i]}+{names[j]}",
            "propulsion",
            "pwm_i <-> pwm_j",
            "answers with the wrong force, opposite in some axis",
            (
                EffectParameter("share", "1", WHOLE, 0.5, 1.0, 0.0, 1.2, mean=1.0),
            ),  # secant over the whole share: at 0.2 some pairs of commands cancel
            {"pwm": _swap(i, j)},
            nonlinear=True,
        )
    yield from _common(vessel)
    yield from _timing(vessel)
    yield from _flow(vessel)


def base(vessel: VesselFile) -> Iterator[Effect]:
    """Neutral pulse widths, and force maps bent otherwise ahead than astern: free in every fit, never named."""
    for i, thruster in enumerate(vessel.thrusters):
        parameter = EffectParameter("trim_us", "us", TRIM_US, TRIM_US, TRIM_US)
        hook = _trimmed(i)
        yield Effect(f"base:trim:{thruster.name}", "base", "trim + delta", "", (parameter,), {"maps": hook})
    curves = [c for m in vessel.force_maps.values() if isinstance(m, RotorMap) for c in (m.ahead, m.astern)]
    if most := ROOM * min((c.c2_rps / (c.q * c.c1_rps) for c in curves), default=0.0):
        share = EffectParameter("share", "1", BEND, BEND, BEND, -most, most)
        text = "n ahead c1 (1 + q share) e^q + (c2 - q share c1) e^2, astern with -share"
        yield Effect("base:bend", "base", text, "", (share,), {"maps": _maps(_bent)})


def _bent(m: RotorMap, p: Values) -> RotorMap:
    """The map of which small commands do more than they should ahead and less astern, full ones the same."""
    return replace(
        m, ahead=_with_less_curvature(m.ahead, p["share"]), astern=_with_less_curvature(m.astern, -p["share"])
    )


def _with_less_curvature(c: RotorCurve, share: float) -> RotorCurve:
    moved_rps = c.q * share * c.c1_rps
    return replace(c, c1_rps=c.c1_rps + moved_rps, c2_rps=c.c2_rps - moved_rps)


def _trimmed(i: int) -> Callable[[Values, VesselFile], VesselFile]:
    def hook(p: Values, vessel: VesselFile) -> VesselFile:
        thrusters = list(vessel.thrusters)
        thrusters[i] = replace(thrusters[i], trim_us=thrusters[i].trim_us + p["trim_us"])
        return replace(vessel, thrusters=tuple(thrusters))

    return hook


def _scaled(vessel: VesselFile, factor: Callable[[Values], float], *which: int) -> dict[str, Hook]:
    """Hook by which thrusters `which` (none: all) give `factor`(p) times their force.

    In a file with a rate limit the gains of the file itself are changed, since the limit acts on the reduced force.
    """
    mine = which or tuple(range(len(vessel.thrusters)))

    def maps(p: Values, vessel: VesselFile) -> VesselFile:
        all_ = enumerate(vessel.thrusters)
        thrusters = tuple(replace(t, gain=t.gain * factor(p)) if i in mine else t for i, t in all_)
        return replace(vessel, thrusters=thrusters)

    def thrust(p: Values, scene: Scene, f: np.ndarray) -> np.ndarray:
        out = f.copy()
        out[..., mine] *= factor(p)
        return out

    return {"maps": maps} if vessel.propulsion.slew_N_s else {"thrust": thrust}


def _fouling(i: int, name: str, onset_s: float, starts: Callable[[], Sequence[Effect]] | None = None) -> Effect:
    """Loss of thruster i from onset_s on; variant of the family of that thruster."""

    def hook(p: Values, scene: Scene, f: np.ndarray) -> np.ndarray:
        out = f.copy()
        since = scene.clock_s - onset_s - p["onset_s"]
        out[..., i] *= 1 + p["gain"] / (1 + np.exp(-np.clip(since, -50, 50)))  # logistic onset, 1 s time scale
        return out

    return Effect(
        f"thruster_fouling:{name}@{onset_s:.0f}",
        "propulsion",
        "f_i (1 + gain) from a time on",
        "as a loss of this thruster that begins during the log",
        (*scalar_parameter("gain", "1", 0.5, 0.08, -1.0, 0.0), EffectParameter("onset_s", "s", 20.0, np.inf, 3.0)),
        {"thrust": hook},
        variant_of=f"thruster_fouling:{name}",
        origin={"onset_s": onset_s},
        start_entries=starts,
    )


def _between(i: int, name: str, onset_s: float, reach_s: float) -> list[Effect]:
    return [_fouling(i, name, onset_s + offset * reach_s) for offset in np.linspace(-1, 1, STARTS)]


def _swap(i: int, j: int) -> Callable[[Values, np.ndarray], np.ndarray]:
    def hook(p: Values, pwm_us: np.ndarray) -> np.ndarray:
        out, s = pwm_us.copy(), p["share"]
        out[:, i] = (1 - s) * pwm_us[:, i] + s * pwm_us[:, j]
        out[:, j] = (1 - s) * pwm_us[:, j] + s * pwm_us[:, i]
        return out

    return hook


def _common(vessel: VesselFile) -> Iterator[Effect]:
    """Effects on all thrusters alike: loss, astern force, voltage, dead band."""
    yield Effect(
        "common_loss",
        "propulsion",
        "all f (1 - loss)",
        "slower in every direction and slower to start; the same as all mass and damping larger",
        scalar_parameter("loss", "1", 0.4, 0.05, -2.0, 0.95),
        _scaled(vessel, lambda p: 1 - p["loss"]),
        same_as=("mass_damping_scale",),
    )
    if not any(isinstance(m, RotorMap) for m in vessel.force_maps.values()):
        return
    yield Effect(
        "astern_asymmetry",
        "propulsion",
        "k_astern (1 + share)",
        "thrusters that run astern give less (or more) than the map has",
        share_parameter(0.4, 0.06),
        {"maps": _maps(lambda m, p: replace(m, k_astern_N_s2=m.k_astern_N_s2 * (1 + p["share"])))},
    )
    yield Effect(
        "voltage_exponent",
        "propulsion",
        "f (V / V_nominal)^exponent",
        "too strong with a full battery and too weak with an empty one, or the other way round",
        scalar_parameter("exponent", "1", 1.2, 0.3),
        {"maps": _maps(lambda m, p: _exponent(m, p["exponent"] / 2, vessel.propulsion.nominal_voltage_V))},
    )
    yield Effect(
        "dead_band",
        "propulsion",
        "dead band + delta",
        "small commands do less than they should",
        scalar_parameter("delta_us", "us", 15.0, 4.0, -20.0, 70.0),
        {"maps": _maps(lambda m, p: replace(m, dead_band_us=min(max(m.dead_band_us + p["delta_us"], 0.0), 100.0)))},
    )


def _exponent(m: RotorMap, delta: float, nominal_V: float) -> RotorMap:
    """Speed times (V / V_nominal)^delta: exponent, and constant that keeps it at the nominal voltage."""
    kept = (m.V_ref_V / nominal_V) ** (2 * delta)
    return replace(
        m,
        ahead=replace(m.ahead, a0=m.ahead.a0 + delta),
        astern=replace(m.astern, a0=m.astern.a0 + delta),
        k_ahead_N_s2=m.k_ahead_N_s2 * kept,
        k_astern_N_s2=m.k_astern_N_s2 * kept,
    )


def _maps(edit: Callable[[RotorMap, Values], RotorMap]) -> Callable[[Values, VesselFile], VesselFile]:
    def hook(p: Values, vessel: VesselFile) -> VesselFile:
        maps = {k: edit(m, p) if isinstance(m, RotorMap) else m for k, m in vessel.force_maps.items()}
        return replace(vessel, force_maps=maps)

    return hook


def _timing(vessel: VesselFile) -> Iterator[Effect]:
    """Effects on the time response of thrust: lag, dead time, rate limit."""
    slew_N_s = vessel.propulsion.slew_N_s
    yield Effect(
        "lag",
        "propulsion",
        "T_lag + lag_s",
        "forces build up and die away slower",
        scalar_parameter("lag_s", "s", 0.15, 0.03, -0.5, 3.0),
        {"maps": _propulsion("lag_s", least=0.005)},
    )
    yield Effect(
        "dead_time",
        "propulsion",
        "t_d + dead_time_s",
        "everything begins later after a command",
        scalar_parameter("dead_time_s", "s", 0.15, 0.04, -0.5, 2.0),
        {"maps": _propulsion("dead_time_s", least=0.0)},
    )
    yield Effect(
        "rate_limit",
        "propulsion",
        "|df/dt| <= 1 / slowness",
        "large changes of thrust take time in proportion to their size",
        (EffectParameter("slowness_s_N", "s/N", 0.03, 1 / 150, 0.02, 0.0, 1.0),),
        {"maps": _limited},
        origin={"slowness_s_N": 1 / slew_N_s} if slew_N_s else {},
        nonlinear=True,
    )


def _propulsion(key: str, least: float) -> Callable[[Values, VesselFile], VesselFile]:
    def hook(p: Values, vessel: VesselFile) -> VesselFile:
        now = vessel.propulsion
        return replace(vessel, propulsion=replace(now, **{key: max(getattr(now, key) + p[key], least)}))

    return hook


def _limited(p: Values, vessel: VesselFile) -> VesselFile:
    """Rate limit 1 / (slowness + 1 / the file's limit) [N/s]; a slowness of zero is no limit."""
    now = vessel.propulsion
    slowness = p["slowness_s_N"] + (1 / now.slew_N_s if now.slew_N_s else 0.0)
    return replace(vessel, propulsion=replace(now, slew_N_s=1 / slowness if slowness > 0 else None))


def _flow(vessel: VesselFile) -> Iterator[Effect]:
    """Effects of the flow on thrust: wash, then loss with advance speed, in the order of the model."""
    pairs = washed_pairs(vessel)

    def advance(p: Values, scene: Scene, f: np.ndarray) -> np.ndarray:
        nu_r = moving(scene)[2]
        return np.stack(advanced(list(np.moveaxis(f, -1, 0)), vessel.positions, nu_r, p["loss_s_m"]), axis=-1)

    def wash(p: Values, scene: Scene, f: np.ndarray) -> np.ndarray:
        blowing = [Jet(*pair, p["loss"] / WASH_N) for pair in pairs]
        return np.stack(washed(list(np.moveaxis(f, -1, 0)), blowing), axis=-1)

    if pairs:
        yield Effect(
            "wash",
            "propulsion",
            "f_behind (1 - loss f_ahead / 30 N)",
            "the thruster behind gives less while the one before it blows at it",
            scalar_parameter("loss", "1", 0.5, 0.10, -0.5, 2.0),
            {"thrust": wash},
        )
    yield Effect(
        "advance_loss",
        "propulsion",
        "f_i - loss |f_i| u_a,i (T_nu |n| u_a: Fossen 2011, 9.2)",
        "thrust falls with speed through the water along the thruster",
        scalar_parameter("loss_s_m", "s/m", 0.4, 0.05),
        {"thrust": advance},
    )


def washed_pairs(vessel: VesselFile) -> list[tuple[int, int, int]]:
    """(behind, ahead, sign of the force ahead that blows at the one behind) of each pair in line on one side."""
    x, y, _ = vessel.positions.T
    fore = [int(i) for i in np.argsort(-x)]
    pairs = [(j, i) for i in fore for j in fore if x[i] > x[j] and np.sign(y[i]) == np.sign(y[j])]
    return [(j, i, jet_sign(vessel.thrusters[i], vessel.thrusters[j])) for j, i in pairs]
