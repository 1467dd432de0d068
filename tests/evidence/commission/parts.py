"""Evidence for commissioning: from an unknown boat to one that drives well, by itself."""

from tests.evidence.commission.boats import boats

PARTS = (boats,)
