"""Our estimate for the autopilot's own filter: what `drivers.mavlink.vision` decides, as frames to send."""

from __future__ import annotations

import math

from companion.core.configuration.site_file import Site
from companion.core.configuration.vessel_file import VesselFile
from companion.core.messages import StateEstimate
from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.vision import OriginFeed, VisionFeed


class PositionFeed:
    """The feed of one run. `rate_hz`: at most; `codec`: of the link to the autopilot."""

    def __init__(self, rate_hz: float, site: Site, vessel: VesselFile, codec: MavlinkCodec) -> None:
        imu = vessel.sensors.imu
        self._site, self._encoder = site, codec.encoder
        self._vision = VisionFeed(rate_hz, math.radians(site.rotation_deg), (imu.x_m, imu.y_m))
        self._origin = OriginFeed(lambda: codec.counters.from_target("GPS_GLOBAL_ORIGIN"))

    def frames(self, estimate: StateEstimate, *, restarts: int, begins: int) -> list[bytes]:
        """What to send for a new estimate. `restarts`: of the estimator; `begins`: of the session, 0: not yet."""
        out: list[bytes] = []
        if begins and self._origin.due(begins, estimate.t_ns):
            out.append(self._encoder.global_origin(self._site.lat_deg, self._site.lon_deg))
        if fix := self._vision.step(estimate, restarts):
            out.append(self._encoder.vision_position(fix))
        return out
