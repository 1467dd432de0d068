"""Evidence for commissioning: a boat that becomes known by itself, and is watched afterwards."""

from tests.evidence.commission import watch
from tests.evidence.commission.boats import boats
from tests.evidence.commission.killed import killed
from tests.evidence.commission.on_firmware import on_firmware

PARTS = (boats, killed, on_firmware, *watch.PARTS)
