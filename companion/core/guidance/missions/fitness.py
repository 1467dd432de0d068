"""Whether a mission that can be read can be driven: by this boat, within these fences."""

from __future__ import annotations

from collections.abc import Iterator

from companion.core.geometry.fence import Fence
from companion.core.guidance.missions.draft import Mission
from companion.core.guidance.reference import GuidanceSettings
from companion.core.guidance.steerage import corner_faults


def unfit_waypoints(mission: Mission, fence: Fence, settings: GuidanceSettings) -> Iterator[tuple[int, str]]:
    """What keeps a mission from being driven: (index of the waypoint, words) of each problem.

    Waypoints beyond the fence, and corners that a boat which needs way cannot round; metres in site axes.
    """
    for i, w in enumerate(mission.path.waypoints):
        if (room_m := fence.clearance(w.north_m, w.east_m)) < 0:
            yield i, f"lies {-room_m:.1f} m beyond the fence"
    yield from corner_faults(mission.path, settings)
