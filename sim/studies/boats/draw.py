"""Random boats around a vessel file, on which the structured fit is judged."""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from companion.core.configuration.vessel_file import VesselFile
from sim.world.plant import perturbed

TICK_S = 0.01  # dead times are whole hundredths, as in all figures so far
ARM_SIGMA_M = 0.02  # error of a tag's place measured with a tape; assumed


def in_still_air(vessel: VesselFile) -> VesselFile:
    """The vessel with the drag of still air as a term of its model, as the simulated world always has it.

    It is half a per cent of the hull's drag; a fit without the term attributes it to the hull.
    """
    calm: dict[str, float | str] = {
        "source": "air at rest; coefficients as the simulated world has them",
        "V_w_m_s": 0.0,
    }
    return replace(vessel, terms={**vessel.terms, "wind": {**calm, **vessel.terms.get("wind", {})}})


def draw_boat(
    vessel: VesselFile, rng: np.random.Generator, *, share: float = 0.30, gain_sigma: float = 0.025
) -> VesselFile:
    """A boat whose inertia, damping, dead time, lag and UWB latency differ from the file's by up to `share` (uniform).

    Thruster gains: normal with `gain_sigma` about the file's, as single T200 differ; uniform within `share` where
    `gain_sigma` is 0. Motion shows only the ratio of force to inertia, so the common gain must be known beforehand. The
    tag is `ARM_SIGMA_M` (normal, each axis) off its place.
    """
    boat = perturbed(vessel, rng, share)
    if gain_sigma:
        gains = [t.gain * (1 + gain_sigma * float(rng.normal())) for t in vessel.thrusters]
        boat = replace(boat, thrusters=tuple(replace(t, gain=g) for t, g in zip(boat.thrusters, gains, strict=True)))
    off = [1 + float(v) for v in rng.uniform(-share, share, 3)]
    propulsion = replace(
        boat.propulsion,
        dead_time_s=round(boat.propulsion.dead_time_s * off[0] / TICK_S) * TICK_S,
        lag_s=boat.propulsion.lag_s * off[1],
    )
    uwb = boat.sensors.tag
    arm = [float(v) for v in rng.normal(0, ARM_SIGMA_M, 2)]
    uwb = replace(uwb, latency_s=uwb.latency_s * off[2], x_m=uwb.x_m + arm[0], y_m=uwb.y_m + arm[1])
    return replace(boat, propulsion=propulsion, sensors=replace(boat.sensors, uwb=uwb))
