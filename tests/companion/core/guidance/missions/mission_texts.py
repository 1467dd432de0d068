"""Missions as text in the formats that are read, and the errors they give."""

import math

import pytest

from companion.core.geometry.frames import Origin
from companion.core.guidance.missions.mission import MissionErrors, parse

ORIGIN = Origin(12.9915, 80.2337)
TURNED = Origin(12.9915, 80.2337, math.radians(30.0))


def errors(text, kind, origin=ORIGIN):
    with pytest.raises(MissionErrors) as caught:
        parse(text, kind, origin=origin)
    return [str(e) for e in caught.value.errors]
