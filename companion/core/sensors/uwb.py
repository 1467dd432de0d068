"""UWB tag: ranges to anchors, or a position of its own. Equations in the filter: `estimation.ranging`.

range     |k (p + R(psi) l) - a_i| + b_i        position  k (p + R(psi) l)        k = 1 + `scale`
"""

from __future__ import annotations

from msgspec.structs import replace

from companion.core.configuration.sensors import Uwb
from companion.core.messages import Measured, UwbPosition, UwbRanges
from companion.core.model.sensor_errors import correct_uwb_scale, measurement_time_ns
from companion.core.sensors.sensor import ErrorState, PositionHealth, PositionWords, Sensor, verdict, within

MAX_DISTANCE_M = 2000.0
"""Beyond any UWB; assumed."""
BIAS_WALK_M_SQRT_S = 0.0005
"""Random walk of an anchor's bias; assumed."""
HEALTH = PositionHealth("UWB", 3.0, 0.5, 3.0)
"""Three cycles at 1 Hz; sigmas: assumed, lost at a tenth of the basin."""


class RangingSensor(Sensor):
    """The tag of a vessel file, among `anchors` of the site: one bias each."""

    key, label, messages, health = "uwb", "UWB", (UwbRanges, UwbPosition), HEALTH
    words = PositionWords("anchors elsewhere than in the site file", "anchors", "UWB ranges")

    def __init__(self, uwb: Uwb, anchors: int):
        self._uwb, self.rate_Hz = uwb, uwb.rate_Hz
        self.error_states = (ErrorState(uwb.range_bias_sigma_m, walk=BIAS_WALK_M_SQRT_S),) * anchors

    @staticmethod
    def screen(m: UwbRanges | UwbPosition) -> tuple[UwbRanges | UwbPosition | None, str]:
        """Finite, and no farther than a radio of this kind reaches. Bad ranges are taken out one by one."""
        if isinstance(m, UwbPosition):
            return verdict(m, within(MAX_DISTANCE_M, m.x_m, m.y_m, m.z_m), "position")
        good = tuple(r for r in m.ranges if 0 < r.range_m <= MAX_DISTANCE_M)
        if len(good) == len(m.ranges):
            return m, ""
        kept = UwbRanges(t_ns=m.t_ns, t_rx_ns=m.t_rx_ns, tag=m.tag, ranges=good)
        return kept if good else None, "range: not finite or absurd"

    def correct(self, m: UwbRanges | UwbPosition) -> UwbRanges | UwbPosition:
        """A position without the known scale; ranges are left to the filter's equations."""
        if isinstance(m, UwbRanges) or not self._uwb.scale:
            return m
        north, east = correct_uwb_scale(self._uwb, m.y_m, m.x_m)
        return replace(m, y_m=float(north), x_m=float(east))

    def measured_ns(self, m: Measured, zero_ns: int | None) -> int:
        """Tags stamp nothing: arrival less the latency, which drifts from the first message on."""
        t_ns = super().measured_ns(m, zero_ns)
        return measurement_time_ns(self._uwb, t_ns, t_ns if zero_ns is None else zero_ns)

    def place(self, m: UwbRanges | UwbPosition) -> tuple[float, float] | None:
        """Of the tag's own position; of ranges none by themselves (`estimation.start`)."""
        return (m.y_m, m.x_m) if isinstance(m, UwbPosition) else None
