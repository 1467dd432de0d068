"""Evidence for the house: sizes, names and walls; and that moving everything changed neither behaviour nor speed."""

from __future__ import annotations

from tests.evidence.house.closed_loop import closed_loop
from tests.evidence.house.rooms import rooms
from tests.evidence.house.speed import speed
from tests.evidence.house.suite import suite

PARTS = (rooms, closed_loop, speed, suite)
