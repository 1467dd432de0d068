"""Evidence for trust: a boat that notices when it does not do what it is told, says why, and drives on where it can."""

from tests.evidence.trust import boat_holes, driving, faults, file_holes, real_boat, stop

PARTS = (*faults.PARTS, *driving.PARTS, *real_boat.PARTS, *stop.PARTS, *boat_holes.PARTS, *file_holes.PARTS)
