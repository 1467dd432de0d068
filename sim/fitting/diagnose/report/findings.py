"""Format of findings.json, the result of a diagnosis for programs. Parameters and units: docs/diagnose.md. Verdicts:

none        no cause, no systematic residual
named       causes, no systematic residual
partial     causes, but a systematic residual: they may stand in for something else, see `depends_on`
ambiguous   a cause has a rival of another equivalence class within `RIVAL_NATS`
unknown     a systematic residual that no effect of the catalogue explains
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import msgspec

from sim.fitting.wiring.record import WiringFinding, WiringReport

Verdict = Literal["none", "named", "partial", "ambiguous", "unknown"]
RIVAL_NATS = 6.0
FINDINGS, REPORT = "findings.json", "report.html"
REFITTED, NUMBERS, EXTENDED = "refitted.toml", "extended_numbers.toml", "extended.toml"
OUTPUTS = (REFITTED, NUMBERS, EXTENDED, REPORT, FINDINGS)
MANOEUVRE = "manoeuvre.toml"
"""Written as well where a manoeuvre was planned."""
Number = float | None
"""None where it is not finite."""


class _Struct(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base: an unknown key is an error."""


class ParameterRecord(_Struct, frozen=True, kw_only=True):
    """One number of a cause."""

    value: float
    se: float
    ci95: tuple[float, float]
    unit: str


class CauseRecord(_Struct, frozen=True, kw_only=True):
    """One cause. `size`: over the smallest worth a name, which is `smallest_size`; `size_low`: its lower 95 % limit.

    `form_doubtful`: the family is right, but a systematic residual depends on the same variables.
    """

    name: str
    sentence: str
    parameters: dict[str, ParameterRecord]
    evidence_nats: float
    size: float
    size_low: float
    smallest_size: float
    smallest_unit: str
    form_doubtful: bool = False


def wiring_cause(finding: WiringFinding) -> CauseRecord:
    """Thrusters that are connected in another way, as a cause: all of a command goes elsewhere."""
    return CauseRecord(
        name=finding.name.replace("swapped:", "swapped_pair:"),
        sentence=f"{finding.text[0].upper()}{finding.text[1:]}.",
        parameters={},
        evidence_nats=finding.nats or 0.0,
        size=2.0,
        size_low=2.0,
        smallest_size=0.5,
        smallest_unit="1",
    )


class RankRecord(_Struct, frozen=True, kw_only=True):
    """One candidate at the last step: nats for it, over its absence; size over the smallest worth a name."""

    name: str
    evidence_nats: float
    size: float


class Check(_Struct, frozen=True, kw_only=True):
    """One check of adequacy, passed while `value` is below `limit`; without `decides` for information only."""

    name: str
    value: float
    limit: float
    passed: bool
    decides: bool = True


class Adequacy(_Struct, frozen=True, kw_only=True):
    """Whether the model with its causes leaves no systematic residual. `depends_on`: words, the most likely first."""

    passed: bool
    checks: tuple[Check, ...] = ()
    depends_on: tuple[str, ...] = ()


class Pair(_Struct, frozen=True, kw_only=True):
    """Expected nats of cause `a` of medium size over `b` (empty: over nothing); below 12 they are not separated."""

    a: str
    b: str
    nats: float


class Identifiability(_Struct, frozen=True, kw_only=True):
    """Distinguishability by these logs.

    pairs              below 12 nats, each once, and the weakest above
    nothing            by cause of medium size, nats over its absence (below 9: not named)
    manoeuvre          sentence: what to fly; `manoeuvre_file`: the excitation file
    manoeuvre_pairs    pairs with the estimated nats of these logs and the manoeuvre together
    """

    pairs: tuple[Pair, ...] = ()
    nothing: dict[str, float] = {}
    manoeuvre: str = ""
    manoeuvre_file: str = ""
    manoeuvre_pairs: tuple[Pair, ...] = ()


class HeldOutRecord(_Struct, frozen=True, kw_only=True):
    """Rms error of a channel's readings a horizon after the start, with 95 % intervals; gain of extended over refit."""

    horizon_s: int
    channel: str
    unit: str
    base: Number
    refit: Number
    extended: Number
    ci: dict[str, tuple[Number, Number]]
    gain: Number
    windows: int


class NoiseCard(_Struct, frozen=True, kw_only=True):
    """Estimated noise, one sigma. `latent`, `latent_base`: latent accelerations of surge, sway, yaw with and without

    causes [m/s^2, m/s^2, rad/s^2]; `ambient`: the same in the reference log (None: no such log).
    """

    source: str
    heading_rad: float
    yaw_rate_rad_s: float
    accel_x_m_s2: float
    accel_y_m_s2: float
    position_m: float
    latent: tuple[float, float, float]
    latent_base: tuple[float, float, float]
    ambient: tuple[float, float, float] | None


class DetectionLimit(_Struct, frozen=True, kw_only=True):
    """The size from which on these logs would have shown an effect."""

    size: float
    unit: str


class FindingsLog(_Struct, frozen=True, kw_only=True):
    """One log and what it was used for; intervals [s] on its own clock."""

    name: str
    data_hash: str
    duration_s: float
    fitted_s: tuple[tuple[float, float], ...]
    held_out_s: tuple[tuple[float, float], ...]
    problems: tuple[str, ...]


class Findings(_Struct, frozen=True, kw_only=True):
    """The file. `vessel`: name of the vessel file with the causes; `extended_vessel`: base numbers beside the causes.

    `withdrawn`: by name of causes that were selected and then withdrawn, the reason.
    """

    format: Literal[1] = 1
    kind: Literal["aritra-diagnose"] = "aritra-diagnose"
    verdict: Verdict
    summary: tuple[str, ...]
    wiring: WiringReport = WiringReport()
    causes: tuple[CauseRecord, ...]
    ambiguous_with: tuple[str, ...]
    withdrawn: dict[str, str] = {}
    depends_on: tuple[str, ...]
    equivalence_class: dict[str, tuple[str, ...]]
    ranking: tuple[RankRecord, ...]
    adequacy: Adequacy | None
    identifiability: Identifiability | None
    visible_from: dict[str, DetectionLimit]
    held_out: tuple[HeldOutRecord, ...]
    one_step_nats: dict[str, Number]
    noise_card: NoiseCard
    vessel: str = EXTENDED
    refitted_vessel: str = REFITTED
    extended_vessel: str = NUMBERS
    not_in_file: dict[str, str]
    logs: tuple[FindingsLog, ...]
    data_hash: str
    base: str
    base_sha256: str
    seed: int
    runtime_s: float
    versions: dict[str, str]
    command: tuple[str, ...]


def verdict_of(
    names: Sequence[str],
    rivals: Mapping[str, Sequence[tuple[str, float]]],
    same: Mapping[str, Sequence[str]],
    adequacy: Adequacy | None,
) -> tuple[Verdict, tuple[str, ...], dict[str, tuple[str, ...]]]:
    """Verdict, causes that may be named, and by cause (named or not) its rivals within `RIVAL_NATS`.

    `rivals`: by cause, (other, nats by which it explains less); `same`: by cause, others of its equivalence class.
    `adequacy` None: no systematic residual.
    """
    close = {
        name: tuple(other for other, behind in rivals.get(name, ()) if behind < RIVAL_NATS
                    and other not in names and other not in same.get(name, ()))
        for name in names
    }  # fmt: skip
    confused = {name: others for name, others in close.items() if others}
    if adequacy is not None and not adequacy.passed:
        sure = tuple(name for name in names if not close[name])
        return ("partial" if sure else "unknown"), sure, confused
    return ("ambiguous" if confused else "named" if names else "none"), tuple(names), confused
