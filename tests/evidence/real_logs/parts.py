"""Evidence for logs of boats that nobody here wrote."""

from tests.evidence.real_logs import inputs, new_boats, signs

PARTS = (*inputs.PARTS, *signs.PARTS, *new_boats.PARTS)
