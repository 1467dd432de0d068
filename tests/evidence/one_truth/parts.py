"""Evidence for one truth: what is found is what is written, and what is written is what moves the boat."""

from tests.evidence.one_truth.actuators import actuators
from tests.evidence.one_truth.effects import effects, pairs
from tests.evidence.one_truth.flights import flights
from tests.evidence.one_truth.gnss import GNSS_PARTS

PARTS = (effects, pairs, *GNSS_PARTS, actuators, flights)
