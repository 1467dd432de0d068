"""Flights that show which thruster pushes where, and in which axes heading and positions count.

    pulses    one thruster at a time: they turn a boat, and tell its thrusters apart
    legs      all together ahead and astern, and to both sides where they can, a turn between them: a boat that two
              thrusters only push ahead shows the axes of its positions by going to and fro about a metre, on headings
              that differ; front and rear of one side of an X boat, with changed places, push aside the wrong way and
              do nothing else wrong

Nothing here takes the file's word: a leg of a boat whose thruster is reversed is a turn, and its turn a leg. There is
no way back under power, for it might be the way out, and the filter is told that the file's forces may be as wrong as
they are large (`distrusted`): what is left are positions, heading and accelerations.
"""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from companion.core.configuration.vessel_file import ModelError, VesselFile
from companion.core.control.allocation import force_limits
from companion.core.estimation.tuning import EstimatorTuning
from companion.core.excitation.file import Pulses, Segment, Steps
from companion.core.excitation.signal import axis_reach
from companion.core.model.manoeuvring import mass_matrix
from companion.core.model.thrusters import configuration_matrix

PULSE_S, PULSE_LEVEL, REST_S = (0.2, 0.6, 1.2, 1.2), 0.4, 0.6
"""Duration of a thruster's pulses in the first, second .. try, the share of its limit, and the rest after each.
Assumed: the first moves a boat of 45 kg by less than 0.1 m/s."""
SIGNS_PULSES, CONFIRMED = 8, 2
"""Pulses of all thrusters ahead in a flight, and as many astern; flights before signs count as known. Assumed."""
LEG_M_S = (0.0, 0.4, 0.6, 0.6)
"""Speed of the file's boat at the end of a leg's push, by try. Assumed: 0.4 m/s is a metre to and fro, several sigmas
of a position."""
LEGS, TURN_RAD_S = 3, 0.35
"""Legs of a flight, and the yaw rate of the file's boat at the end of the turn's push. Assumed: a turn and what is left
of it during the leg are about 80 degrees, and three headings 80 degrees apart lie on the axis of no mirror together."""
PUSH_S, COASTING = 1.0, (0.0, 0.0)
"""Duration of a push of legs and turns, and the levels after it, as long each, while the boat coasts; assumed."""


def signs_segments(vessel: VesselFile, flown: int) -> tuple[Segment, ...]:
    """Segments of the flight after `flown` others."""
    pulses = Pulses(
        name="each thruster",
        why="which way each pushes",
        levels=(PULSE_LEVEL, -PULSE_LEVEL),
        on_s=PULSE_S[flown],
        off_s=REST_S,
    )
    rounds = -(-SIGNS_PULSES // len(vessel.thrusters))
    return (*_legs(vessel, LEG_M_S[flown]), *(pulses,) * rounds)


def _legs(vessel: VesselFile, speed_m_s: float) -> tuple[Segment, ...]:
    """To and fro along both axes on several headings, at the speed that the file's boat gets; none at rest."""
    reach, inertia = axis_reach(vessel), np.diag(mass_matrix(vessel))
    if not speed_m_s or not reach[[0, 2]].all():
        return ()
    ahead = _to_and_fro(reach[0], speed_m_s * inertia[0])
    legs = [Steps(name="to and fro", why="in which axes positions count", X=1.0, levels=ahead, hold_s=PUSH_S)]
    if reach[1].all():
        aside, why = _to_and_fro(reach[1], speed_m_s * inertia[1]), "which thrusters push to which side"
        legs.append(Steps(name="sideways", why=why, Y=1.0, levels=aside, hold_s=PUSH_S))
    turn = min(_levels(reach[2], TURN_RAD_S * inertia[2]))
    legs.append(Steps(name="turn", why="another heading", N=1.0, levels=(turn, *COASTING), hold_s=PUSH_S))
    return tuple(legs) * LEGS


def _to_and_fro(reach: np.ndarray, momentum: float) -> tuple[float, ...]:
    """Levels of a push each way, with time to coast after it."""
    there, back = _levels(reach, momentum)
    return there, *COASTING, -back, *COASTING


def _levels(reach: np.ndarray, momentum: float) -> tuple[float, float]:
    """Shares of the `reach` (2,) both ways that give the momentum in one push, `PULSE_LEVEL` at most."""
    there, back = np.minimum(momentum / PUSH_S / reach, PULSE_LEVEL).round(3).tolist()
    return there, back


def distrusted(vessel: VesselFile) -> VesselFile:
    """The vessel with a model error as large as a thruster makes that pushes the other way: twice its pulse's force."""
    lower, upper = force_limits(vessel)
    wrong = 2 * PULSE_LEVEL * np.abs(configuration_matrix(vessel)) * np.maximum(upper, -lower)
    X, Y, N = np.maximum(wrong.max(axis=1), EstimatorTuning().lively_sigma).round(2).tolist()
    source = "assumed: which way thrusters push is not known yet"
    return replace(vessel, model_error=ModelError(X_sigma_N=X, Y_sigma_N=Y, N_sigma_N_m=N, source=source))
