"""Public form of estimates: names, units and signs as in `findings.json`.

The fit's parameters are zero where an effect is absent and nearly linear (`effect`); a reader wants a gain of 0.73, a
speed and a direction, newtons per second. Each entry of `PUBLIC` maps the fit's parameters (origin added; numbers or
arrays of draws) to public ones, with units, a sentence, and the smallest size worth a name in public units. A user's
effect without an entry keeps its own names.

95 % intervals: where the form is the identity or adds constants, value +- 1.96 se; elsewhere the 2.5 and 97.5 %
quantiles of the form over draws from the estimate's normal distribution, clipped to the parameters' limits. Directions
are unwrapped round the value.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim.fitting.diagnose.catalogue.effect import Effect
from sim.fitting.diagnose.vessel_edits.public_table import DIRECTIONS, PUBLIC, Form, LogReference, PublicEntry

Z975 = 1.959964
DRAWS = 20_000
_NOTHING = np.zeros((64, 64))


@dataclass(frozen=True)
class PublicForm:
    """One public number: value, standard error, 95 % interval, unit.

    As text in `format`: `{x}` with unit and interval; `{x:%}` a share in per cent; `{x:gain}` a gain as "27 % less";
    `{x:heavier/lighter}` its size and the word that goes with its sign, so do its limits where these are of both signs;
    what follows `|` stands before the interval.
    """

    value: float
    se: float
    ci95: tuple[float, float]
    unit: str

    def __format__(self, spec: str) -> str:
        form, _, tail = spec.partition("|")
        reference, form = (1.0, "%more/less") if form == "gain" else (0.0, form)
        scale, unit = 1.0, "" if self.unit == "1" else f" {self.unit}"
        if form.startswith("%"):
            scale, unit, form = 100.0, " %", form[1:]
        value, low, high = (scale * (number - reference) for number in (self.value, *self.ci95))
        if not form:
            return f"{_digits(value)}{unit}{tail} (95 %: {_digits(low)} to {_digits(high)})"
        more, less = form.split("/")
        word = less if value < 0 or (value == 0 and high <= 0) else more
        near, far = sorted((abs(low), abs(high)))
        limits = f"{_digits(near)} to {_digits(far)}"
        if low < 0 < high:
            limits = f"between {_digits(-low)} {less} and {_digits(high)} {more}"
        return f"{_digits(abs(value))}{unit} {word}{tail} (95 %: {limits})"


def _digits(value: float) -> str:
    """Three significant digits; above 1000 whole numbers."""
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"


def public_form(
    effect: Effect, values: Sequence[float] | np.ndarray, covariance: np.ndarray, place: LogReference, seed: int = 0
) -> dict[str, PublicForm]:
    """Public numbers of an effect from the fit's `values` (k,) and their covariance (k, k); `seed`: of the draws.

    ValueError where the entry of `PUBLIC` and the effect's parameters do not match.
    """
    values, covariance = np.asarray(values, dtype=float), np.asarray(covariance, dtype=float)
    entry = PUBLIC.get(family(effect.name))
    if entry is None or entry.form is None:
        return _plain(effect, values, covariance, entry)
    at_estimate = _formed(effect, entry.form, values, place)
    if set(at_estimate) != set(entry.units):
        raise ValueError(
            f"effect {effect.id}: public form gives {sorted(at_estimate)}, units are of {sorted(entry.units)}"
        )
    rng = np.random.default_rng(seed)
    draws = rng.multivariate_normal(values, (covariance + covariance.T) / 2, DRAWS, method="eigh")
    draws = np.clip(draws, *effect.limits())
    spread = _formed(effect, entry.form, draws.T, place)
    out = {}
    for name, value in at_estimate.items():
        drawn, at = np.broadcast_to(spread[name], DRAWS), float(value)
        if name in DIRECTIONS:
            drawn = at + (drawn - at + 180) % 360 - 180
        low, below, above, high = np.quantile(drawn, (0.025, 0.1587, 0.8413, 0.975))
        interval = (float(min(low, at)), float(max(high, at)))
        out[name] = PublicForm(at, float(above - below) / 2, interval, entry.units[name])
    return out


def public_values(effect: Effect, values: Sequence[float] | np.ndarray, place: LogReference) -> dict[str, float]:
    """Public values without intervals."""
    entry = PUBLIC.get(family(effect.name))
    if entry is None or entry.form is None:
        return {name: number.value for name, number in _plain(effect, np.asarray(values), _NOTHING, entry).items()}
    return {name: float(v) for name, v in _formed(effect, entry.form, np.asarray(values), place).items()}


def smallest_size(effect: Effect, times: float = 1.0) -> tuple[float, str]:
    """`times` the smallest size worth a name in public units, and the unit."""
    parameter = effect.parameters[0]
    entry = PUBLIC.get(family(effect.name))
    if entry is None:
        return times * parameter.smallest, parameter.unit
    size = times * parameter.smallest + effect.origin.get(parameter.name, 0.0)
    return float(entry.smallest(size)), entry.smallest_unit or parameter.unit


def sentence(name: str, numbers: Mapping[str, PublicForm]) -> str:
    """Sentence of the effect `name` with its public numbers."""
    entry, tail = PUBLIC.get(family(name)), name.partition(":")[2]
    if entry is None:
        text = ", ".join(f"{key} {number}" for key, number in numbers.items())
        return f"{name}: {text}." if text else f"{name}."
    gain = numbers.get("gain")
    if family(name) == "thruster_gain" and gain is not None and gain.value < 0.1:
        how = "gives no thrust" if gain.value > -0.1 else "pushes the wrong way round"
        return f"Thruster {tail} {how}: its force is {gain} times the model's."
    return entry.says.format(name=tail, both=" and ".join(tail.split("+")), **numbers)


def family(name: str) -> str:
    """`thruster_gain` of `thruster_gain:front_port`."""
    return name.partition(":")[0]


def _plain(
    effect: Effect, values: np.ndarray, covariance: np.ndarray, entry: PublicEntry | None
) -> dict[str, PublicForm]:
    """Public numbers under the parameters' own names, value +- 1.96 se."""
    own = effect.by_name(map(float, values))
    if entry is not None and set(own) != set(entry.units):
        raise ValueError(f"effect {effect.id}: has {sorted(own)}, its public entry expects {sorted(entry.units)}")
    out = {}
    for i, p in enumerate(effect.parameters):
        value, se = own[p.name], float(np.sqrt(covariance[i, i]))
        out[p.name] = PublicForm(value, se, (value - Z975 * se, value + Z975 * se), p.unit)
    return out


def _formed(effect: Effect, form: Form, values: np.ndarray, place: LogReference) -> dict[str, np.ndarray]:
    named = effect.by_name(values)
    try:
        return form(named, place)
    except KeyError as missing:
        has = ", ".join(named)
        raise ValueError(f"effect {effect.id}: its public form asks for {missing}, it has {has}") from None
