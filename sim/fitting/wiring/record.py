"""What was found of the wiring, for reports and programs, and in sentences."""

from __future__ import annotations

import msgspec

VESSEL = "wiring.toml"
"""The vessel file with the thrusters as they are connected; written where that is not as the file says."""
SURE_NATS = 6.0
"""From here on the file as it is is out of the question."""
COMMENT = (
    "The vessel file with the thrusters as the logs show them connected; names and channels are those of the commands."
)


class WiringFinding(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One finding. `nats`: over the file as it is, None where a correlation decides; `logs`: in which it was found.

    certain     it is put right; else it is told only
    rivals      what these logs hardly tell from it; `against`: logs that say otherwise
    thrusters   a matter of the vessel file, not of a log's columns
    advice      what to do about it, where nothing is put right
    test        how to tell it from its rivals; empty: by each thruster alone
    """

    name: str
    text: str
    nats: float | None = None
    logs: tuple[str, ...] = ()
    certain: bool
    rivals: tuple[str, ...] = ()
    against: tuple[str, ...] = ()
    thrusters: bool = False
    advice: str = ""
    test: str = ""


class WiringReport(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All findings.

    unknown     faults that the logs can neither show nor exclude
    logs        how many could be judged; None: nobody asked
    as_found    nothing was put right, as asked for
    left_out    reference logs of which the same does not hold
    """

    findings: tuple[WiringFinding, ...] = ()
    unknown: tuple[str, ...] = ()
    logs: int | None = None
    as_found: bool = False
    left_out: tuple[str, ...] = ()

    @property
    def corrected(self) -> tuple[WiringFinding, ...]:
        """What was put right."""
        return () if self.as_found else tuple(f for f in self.findings if f.certain)

    @property
    def vessel_changed(self) -> bool:
        """Whether thrusters were put right, so that the vessel file is another than the one given."""
        return any(f.thrusters for f in self.corrected)

    @property
    def lines(self) -> tuple[str, ...]:
        """What was found, in sentences."""
        left_out = (f"Left out: {name}, recorded when the boat was connected otherwise." for name in self.left_out)
        return (*(self._sentence(f) for f in self.findings), *left_out)

    @property
    def open_lines(self) -> tuple[str, ...]:
        """What could not be judged, in a sentence, if anything."""
        if self.logs == 0:
            return (f"{HEAD} these logs hold too little to judge how thrusters and sensors are connected.",)
        if self.unknown:
            return (f"{HEAD} these logs cannot tell whether {_listed(self.unknown)}. {TEST}",)
        return ()

    def _sentence(self, f: WiringFinding) -> str:
        by = f" ({f.nats:g} nats over the file as it is)" if f.nats is not None else f", in {', '.join(f.logs)}"
        if f.advice:
            return f"{HEAD} {f.text}{by}. Left as it is: {f.advice}."
        rivals = f" These logs hardly tell it from: {_listed(f.rivals)}." if f.rivals else ""
        if not f.certain and f.rivals and not f.against and (f.nats or 0.0) >= SURE_NATS:
            return (
                f"{HEAD} not as the file says: either {_listed((f.text, *f.rivals))}{by}. These logs cannot tell "
                f"which: it is left as it is, and no fit to them is to be trusted. {f.test or TEST}"
            )
        if not f.certain:
            why = f"; otherwise in {', '.join(f.against)}" if f.against else ""
            return f"{HEAD} perhaps {f.text}{by}{why}: not clear enough, left as it is.{rivals} {f.test or TEST}"
        if self.as_found:
            return f"{HEAD} {f.text}{by}. Left as it is (--as-found).{rivals}"
        then = f"correct the wiring, or take {VESSEL}" if f.thrusters else "correct what writes the log's columns"
        return f"{HEAD} {f.text}{by}. The fit goes on with that put right; {then}.{rivals}"


LISTED = 4
HEAD = "Signs and sides:"
TEST = "Let each thruster push alone for some seconds, ahead and astern, and log that."


def _listed(texts: tuple[str, ...]) -> str:
    more = len(texts) - LISTED
    return "; or ".join([*texts[:LISTED], *([f"{more} others"] if more > 0 else [])])
