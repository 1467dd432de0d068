"""Evidence for one truth: each effect and each sensor is stated once."""

from __future__ import annotations

from tests.evidence.one_truth.gnss import GNSS_PARTS

PARTS = (*GNSS_PARTS,)
