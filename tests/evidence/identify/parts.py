"""Evidence for identification: from logs to a model that may drive the boat."""

from __future__ import annotations

from tests.evidence.identify import boats, cse1, driven, duration, first_guess, paper

PARTS = (*paper.PARTS, *duration.PARTS, *boats.PARTS, *driven.PARTS, *cse1.PARTS, *first_guess.PARTS)
