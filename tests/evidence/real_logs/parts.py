"""Evidence for logs of boats that nobody here wrote."""

from tests.evidence.real_logs import blueboat, inputs, new_boats, recordings, signs

PARTS = (*inputs.PARTS, *signs.PARTS, *recordings.PARTS, *blueboat.PARTS, *new_boats.PARTS)
