"""Evidence for logs of boats that nobody here wrote."""

from tests.evidence.real_logs import inputs, signs

PARTS = (*inputs.PARTS, *signs.PARTS)
