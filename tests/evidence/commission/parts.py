"""Evidence for commissioning: a boat that becomes known by itself, and is watched afterwards."""

from tests.evidence.commission import watch
from tests.evidence.commission.boats import boats

PARTS = (boats, *watch.PARTS)
