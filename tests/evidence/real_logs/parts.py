"""Evidence for logs of boats that nobody here wrote."""

from tests.evidence.real_logs import blueboat, inputs, recordings, signs

PARTS = (*inputs.PARTS, *signs.PARTS, *recordings.PARTS, *blueboat.PARTS)
