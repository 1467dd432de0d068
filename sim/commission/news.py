"""What a flight taught, and what is in doubt, in sentences."""

from __future__ import annotations

from sim.commission.belief import BoatBelief
from sim.fitting.engine.parameters import WARP
from sim.fitting.excite.design import gain_nats
from sim.fitting.excite.information import indices_of_interest


def doubts(belief: BoatBelief) -> str:
    """Why nothing but pulses may be flown, in a sentence."""
    if belief.astray:
        return f"{belief.astray}: correct that, and begin again in another folder"
    lines = (*belief.wiring.lines, *belief.wiring.open_lines)
    return f"signs and sides could not be told: {' '.join(lines) or 'the logs hold too little'}"


def news(before: BoatBelief, after: BoatBelief) -> list[str]:
    """What a flight told, in sentences."""
    known = {finding.name for finding in before.wiring.findings}
    lines = [f"{f.text} ({f.nats:g} nats)" for f in after.wiring.findings if f.name not in known and f.nats is not None]
    if after.problem:
        lines.append(f"no fit yet: {after.problem}")
    if after.fit is not None:
        gained = gain_nats(before.known, after.known, indices_of_interest(after.vessel))
        no_matter = (*WARP, *after.fit.held)
        still = [p.name for p in after.fit.parameters if not p.determined and p.name not in no_matter]
        lines.append(f"{gained:.1f} nats learnt of hull and thrusters")
        lines.append(f"not determined: {', '.join(still)}" if still else "every parameter is determined")
    return lines
