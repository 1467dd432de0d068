"""The simulated ArduPilot Rover: MAVLink bytes of any number of peers in and out, PWM out.

    receive(data, peer, t_ns) -> bytes         answers for that peer, at once
    step(t_ns, sensors) -> [(peer, bytes)]     what is due by t on every link
    outputs_us                                 16 pulse widths [us] as of the last call (0: no pulse)
    outputs_before(t_ns)                       what of them changes until then

The same calls give the same bytes. Times are the simulation's [ns] and must not fall.

A reboot keeps parameters, signing key and peers; for `REBOOT_NS` nothing is sent, heard or put out.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping

from sim.world.autopilot.firmware import FIRMWARE
from sim.world.autopilot.mavlink.files import FtpFiles
from sim.world.autopilot.mavlink.link import PeerLink
from sim.world.autopilot.mavlink.logs import Logs
from sim.world.autopilot.mavlink.missions import MissionStore
from sim.world.autopilot.mavlink.parameter_file import parameter_file
from sim.world.autopilot.mavlink.received import HANDLERS, is_for
from sim.world.autopilot.mavlink.signing import FirmwareSigningKey
from sim.world.autopilot.parameter_table import BOAT_PARAMETERS, CHANNELS
from sim.world.autopilot.parameters import INDEX
from sim.world.autopilot.vehicle import SensorFrame, SimulatedVehicle

GATE_CHANNELS = (9, 10, 11, 12)
"""RC channels that the Lua gate passes to Script1-4."""
REBOOT_NS = 4_000_000_000
"""From the command to the first heartbeat; assumed."""


class Rover:
    """System 1, component 1. `parameters` are changes to the firmware's defaults; ValueError if unknown.

    `boot_ns`: when it was switched on; `drift_ppm`: how much faster than the simulation its clock runs;
    `firmware`: "4.6" or "4.7"; `serial_of(peer)`: the port a peer is on (0: USB, which signing trusts).
    Set afterwards: `files` of the SD card, `logs`.
    """

    def __init__(
        self,
        boot_ns: int,
        parameters: Mapping[str, float] = BOAT_PARAMETERS,
        drift_ppm: float = 0.0,
        gate_channels: tuple[int, ...] = GATE_CHANNELS,
        firmware: str = "4.6",
        serial_of: Callable[[Hashable], int] = lambda peer: 0,
    ):
        if firmware not in FIRMWARE:
            raise ValueError(f"simulated autopilot: firmware {firmware!r}, expected one of {', '.join(FIRMWARE)}")
        self._made_of = drift_ppm, gate_channels, FIRMWARE[firmware]
        self._serial_of = serial_of
        self._up_ns: int | None = None
        self.key = FirmwareSigningKey()
        self.vehicle = SimulatedVehicle(boot_ns, parameters, *self._made_of)
        self.links: dict[Hashable, PeerLink] = {}
        self.files = FtpFiles(counts_nul=FIRMWARE[firmware].counts_nul, virtual=self._virtual_file)
        self.logs = Logs()
        self.missions = MissionStore(self._say, self._count_mission, names_the_fault=FIRMWARE[firmware].minor >= 7)

    @property
    def outputs_us(self) -> tuple[int, ...]:
        """The 16 pulse widths that leave the autopilot now [us]."""
        return (0,) * CHANNELS if self._up_ns is not None else self.vehicle.outputs.pulses_us

    def outputs_before(self, end_ns: int) -> list[tuple[int, tuple[int, ...]]]:
        """What of `outputs_us` changes before `end_ns`: when [ns], and the pulse widths from then on."""
        return [] if self._up_ns is not None else list(self.vehicle.outputs.due_before(end_ns))

    def add_link(self, peer: Hashable) -> None:
        """Start talking to a peer that has not spoken yet; without effect on a known one."""
        if peer not in self.links:
            self.links[peer] = PeerLink(self.vehicle, self.key, self._serial_of(peer))

    def remove_link(self, peer: Hashable) -> None:
        """Forget a peer and its rates; without effect on an unknown one."""
        self.links.pop(peer, None)

    def receive(self, data: bytes, peer: Hashable, t_ns: int) -> bytes:
        """Bytes from `peer` at t; a new peer gets a link. Garbage is counted on the link, never raised."""
        self.add_link(peer)
        if not self._is_up(t_ns):
            return b""
        self.vehicle.advance(t_ns)
        link = self.links[peer]
        for message in link.mav.parse_buffer(data) or ():
            self.key.learn(link.mav)
            handler = HANDLERS.get(message.get_type())
            if message.get_type() == "BAD_DATA":
                link.bad_data += 1
            elif handler is not None and is_for(self, link, message):
                handler(self, link, message)
        self.vehicle.advance(t_ns)
        self._send_texts()
        if self.vehicle.reboot_asked:
            self._up_ns = t_ns + REBOOT_NS
        return link.take()

    def step(self, t_ns: int, sensors: SensorFrame) -> list[tuple[Hashable, bytes]]:
        """Advance to t with new sensor values; the bytes due on each link."""
        if not self._is_up(t_ns):
            return []
        self.vehicle.sense(sensors, t_ns)
        self._send_texts()
        for link in self.links.values():
            link.poll()
        self.logs.poll()
        taken = ((peer, link.take()) for peer, link in self.links.items())
        return [(peer, data) for peer, data in taken if data]

    def _is_up(self, t_ns: int) -> bool:
        """Whether it runs at t; ends a reboot that is over."""
        if self._up_ns is None:
            return True
        if t_ns < self._up_ns:
            return False
        saved = self.vehicle.parameters.saved()
        saved["STAT_BOOTCNT"] += 1
        self.vehicle = SimulatedVehicle(self._up_ns, saved, *self._made_of)
        self.vehicle.modes.mission_items = len(self.missions.items[0])
        self.links = {peer: PeerLink(self.vehicle, self.key, link.serial) for peer, link in self.links.items()}
        self._up_ns = None
        return True

    def _virtual_file(self, path: str) -> bytes | None:
        """Files that the firmware makes when they are opened."""
        return parameter_file(self.vehicle.parameters, path)

    def _say(self, severity: int, text: str) -> None:
        self.vehicle.say(severity, text)

    def _count_mission(self, items: int) -> None:
        """A mission of another size: MIS_TOTAL says so on every link."""
        self.vehicle.modes.mission_items = items
        self.vehicle.parameters.set("MIS_TOTAL", float(items))
        for link in self.links.values():
            link.send_parameter(INDEX["MIS_TOTAL"], by_index=False)

    def _send_texts(self) -> None:
        for severity, text in self.vehicle.texts:
            for link in self.links.values():
                link.send_text(severity, text)
        self.vehicle.texts.clear()
