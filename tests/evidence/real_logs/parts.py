"""Evidence for logs of boats that nobody here wrote."""

from tests.evidence.real_logs import inputs

PARTS = inputs.PARTS
