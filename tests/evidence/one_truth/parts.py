"""Evidence for one truth: what is found is what is written, and what is written is what moves the boat."""

from tests.evidence.one_truth.actuators import actuators

PARTS = (actuators,)
