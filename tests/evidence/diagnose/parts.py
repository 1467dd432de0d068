"""Evidence for diagnosis: what the simulation gets wrong, what is gained by mending it."""

from __future__ import annotations

from tests.evidence.diagnose import cse1, driving, hidden_cases, survive

PARTS = (*hidden_cases.PARTS, *survive.PARTS, *driving.PARTS, *cse1.PARTS)
