"""Evidence for diagnosis: what the simulation gets wrong, what is gained by mending it. Parts: evidence_diagnose_*."""

from __future__ import annotations

import evidence_diagnose_cse1 as cse1
import evidence_diagnose_driving as driving
import evidence_diagnose_hidden as hidden
import evidence_diagnose_survive as survive

PARTS = (*hidden.PARTS, *survive.PARTS, *driving.PARTS, *cse1.PARTS)
