"""Ways in which a boat's thrusters may be connected, each as the vessel file that it makes right.

Every way is tried as a whole: thrusters that changed places (each pair, port with starboard, fore with aft, both), all
of them or one turned round, and one of each together. A command keeps its name and channel; what it drives changes.
Thrusters that do not push are tried beside them: those are left to the fit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from msgspec.structs import replace

from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.thrusters import configuration_matrix

STAY_AT = ("name", "channel")
"""Keys that stay when thrusters change places: a command keeps its name and its channel."""
SAME_PLACE_M = 0.05
DEAD = "dead:"


@dataclass(frozen=True)
class Way:
    """One way. `name`: as in reports, empty for the file as it is; `text`: in words; `faults`: how many."""

    name: str
    text: str
    faults: int
    vessel: VesselFile


def ways(vessel: VesselFile) -> list[Way]:
    """All ways, the file as it is first; of those that push alike (two thrusters in one line) the first."""
    names = [t.name for t in vessel.thrusters]
    places = [("", "", dict[str, str]()), *_swaps(names), *_mirrors(vessel)]
    turned = [("", "", list[str]())]
    turned += [(f"reversed:{n}", f"{n} pushes the wrong way", [n]) for n in names]
    turned += [("reversed:all", "every thruster pushes the wrong way", names)] if len(names) > 1 else []
    found, seen = [], set()
    for place, place_text, moves in places:
        moved = exchanged(vessel, moves, "")
        for sign, sign_text, which in turned:
            one = reversed_ones(moved, which, "")
            B = configuration_matrix(one).round(6).T.tolist()
            pairs = zip(B, one.thrusters, strict=True)
            key = tuple((*column, t.force_map, t.gain, t.trim_us, t.mirrored) for column, t in pairs)
            if key not in seen:
                seen.add(key)
                name = "+".join(n for n in (place, sign) if n)
                text = ", and ".join(t for t in (place_text, sign_text) if t)
                found.append(Way(name, text, bool(place) + bool(sign), one))
    return found + [_dead(vessel, name) for name in names]


def _dead(vessel: VesselFile, name: str) -> Way:
    """A thruster that does not push: no matter of wiring, but halfway to one that pushes the wrong way."""
    thrusters = tuple(replace(t, gain=0.0) if t.name == name else t for t in vessel.thrusters)
    return Way(f"{DEAD}{name}", f"{name} does not push", 1, replace(vessel, thrusters=thrusters))


def exchanged(vessel: VesselFile, moves: Mapping[str, str], note: str) -> VesselFile:
    """`vessel` where the command of each thruster in `moves` drives the one that stands in the file as the other.

    `note` is added to the `source` of what moved.
    """
    by_name = {t.name: t for t in vessel.thrusters}
    moved = [
        replace(there, **{k: getattr(t, k) for k in STAY_AT}, source=append_note(there.source, note))
        if (there := by_name[moves.get(t.name, t.name)]) is not t
        else t
        for t in vessel.thrusters
    ]
    back = {there: name for name, there in moves.items()}
    wash = tuple(
        replace(w, behind=back.get(w.behind, w.behind), ahead=back.get(w.ahead, w.ahead))
        for w in vessel.propulsion.wash
    )
    return replace(vessel, thrusters=tuple(moved), propulsion=replace(vessel.propulsion, wash=wash))


def reversed_ones(vessel: VesselFile, names: Sequence[str], note: str) -> VesselFile:
    """`vessel` with the pulses of the thrusters `names` mirrored about neutral."""
    turned = [
        replace(t, mirrored=not t.mirrored, source=append_note(t.source, note)) if t.name in names else t
        for t in vessel.thrusters
    ]
    return replace(vessel, thrusters=tuple(turned))


def restored(vessel: VesselFile, given: VesselFile) -> VesselFile:
    """`vessel` with its commands driving the places that they have in `given`, and its numbers where they belong."""
    at = {(t.x_m, t.y_m, t.azimuth_deg): t for t in vessel.thrusters}
    there = {t.name: at[t.x_m, t.y_m, t.azimuth_deg] for t in given.thrusters}
    thrusters = (
        replace(there[t.name], name=t.name, channel=t.channel, mirrored=t.mirrored, source=t.source)
        for t in given.thrusters
    )
    names = {now.name: name for name, now in there.items()}
    wash = tuple(replace(w, behind=names[w.behind], ahead=names[w.ahead]) for w in vessel.propulsion.wash)
    return replace(vessel, thrusters=tuple(thrusters), propulsion=replace(vessel.propulsion, wash=wash))


def append_note(source: str, note: str) -> str:
    """`source` of a table with `note` appended once."""
    return source if note in source else f"{source}; {note}"


def _swaps(names: Sequence[str]) -> list[tuple[str, str, dict[str, str]]]:
    return [(f"swapped:{a}+{b}", f"{a} and {b} have changed places", {a: b, b: a}) for a, b in combinations(names, 2)]


def _mirrors(vessel: VesselFile) -> list[tuple[str, str, dict[str, str]]]:
    """Port with starboard, fore with aft, and both: where every thruster has one at the mirrored place."""
    names, places = [t.name for t in vessel.thrusters], vessel.positions[:, :2]
    found = []
    for name, text, sign in (
        ("mirrored:port_starboard", "port and starboard have changed sides", (1, -1)),
        ("mirrored:fore_aft", "fore and aft thrusters have changed places", (-1, 1)),
        ("mirrored:both", "fore and aft, and port and starboard thrusters have changed places", (-1, -1)),
    ):
        far = np.linalg.norm(places[:, None] * sign - places, axis=2)
        to = far.argmin(axis=1)
        if far.min(axis=1).max() <= SAME_PLACE_M and len(set(to)) == len(names):
            found.append((name, text, {names[i]: names[j] for i, j in enumerate(to) if i != j}))
    return found
