"""An hour on still water with nothing to do: whatever is alerted then is a false alarm."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from companion.core.messages import Alert
from sim.world.stepped import SteppedRun
from tests.evidence.firmware.worlds import READY_S, Autopilot, autopilots, world_of
from tests.evidence.line import Line, exactly
from tests.evidence.main_job.parts import reference_boat
from tests.evidence.processes import processes

SHORT_S, HOUR_S = 600.0, 3600.0
MINUTE_S = 60.0


def _lie(case: tuple[Autopilot, float]) -> Counter[str]:
    """Alerts of a boat that lies still for so long, by text; none of the first half minute, in which it starts."""
    autopilot, seconds = case
    _, pilot, nmpc = reference_boat()
    alarms: Counter[str] = Counter()
    with world_of(autopilot, 1) as world:
        run = SteppedRun(world, pilot, nmpc.solve, begin=None)
        run.run(lambda r: False, READY_S)
        run.messages.clear()
        while world.t_ns < (READY_S + seconds) * 1e9:
            run.run(lambda r: False, MINUTE_S)
            alarms.update(alert.text for alert in run.of(Alert) if alert.level != "info")
            run.messages.clear()
    return alarms


def rest(full: bool) -> Iterator[Line]:
    """At rest: alarms of a boat on still water, on every autopilot at hand, for 10 minutes; --full: an hour"""
    kinds, seconds = autopilots(), HOUR_S if full else SHORT_S
    with processes() as pool:
        for kind, alarms in zip(kinds, pool.map(_lie, [(k, seconds) for k in kinds]), strict=True):
            note = "; ".join(f"{count} x {text}" for text, count in alarms.most_common(3))
            yield exactly(f"{kind.name}: alarms in {seconds / 60:g} min", alarms.total(), 0, note=note)
