"""Evidence for identification: from logs to a model that may drive the boat. The parts of evidence_identify_*."""

from __future__ import annotations

import importlib
import importlib.util

import evidence_identify_boats as boats
import evidence_identify_driven as driven
import evidence_identify_paper as paper
import evidence_identify_time as timing

PARTS = (*paper.PARTS, *timing.PARTS, *boats.PARTS, *driven.PARTS)
if importlib.util.find_spec("evidence_identify_cse1"):
    PARTS = (*PARTS, *importlib.import_module("evidence_identify_cse1").PARTS)
