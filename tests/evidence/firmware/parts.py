"""Evidence for the real autopilot: the same lines on the firmware that ARDUROVER names and on the simulated one.

ARDUROVER=path[:path] scripts/evidence firmware: desktop builds of ArduPilot Rover. Without one the lines are of the
simulated autopilot alone, and it says so.
"""

from tests.evidence.firmware.missions import missions, waves
from tests.evidence.firmware.provisioning import provisioning
from tests.evidence.firmware.questions import questions
from tests.evidence.firmware.rest import rest
from tests.evidence.firmware.stall import stall
from tests.evidence.firmware.stops import stops

PARTS = (missions, waves, stall, stops, provisioning, rest, questions)
