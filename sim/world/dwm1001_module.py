"""A simulated DWM1001 module: both of its UART modes, the shell's quirks, and its rate settings.

TLV mode (after power-on): `0C 00` is answered with the last location, CR CR within 1 s enters the shell,
anything else is answered `40 01 01`. Shell: input is echoed, commands end with CR, a bare CR repeats the last
command, `lec`, `lep` and `les` are toggles, `acts`, `aurs`, `quit`, `reset`. Stationary detection is on and
the rate at rest 0.1 Hz until told otherwise, as delivered. Sans-I/O, time as an argument.
"""

from __future__ import annotations

from collections.abc import Sequence

from drivers.uwb.dwm1001 import AnchorReport, TagFix, encode_lec, encode_lep, encode_les
from drivers.uwb.dwm1001_tlv import NOT_UNDERSTOOD, POLL, encode_location

ENTER_NS = 1_000_000_000  # two CRs within this time enter the shell
PROMPT = b"dwm> "
BANNER = (
    b"\r\n DWM1001 TWR Real Time Location System\r\n\r\n Copyright :  2016-2019 LEAPS and Decawave\r\n"
    b" Help      :  ? or help\r\n\r\n"
)


class Dwm1001Module:
    """One module. `rate_hz`: its update rate; `stream`: a stream that runs already, else TLV mode.

    `stationary` may be set from outside: what the module's accelerometer makes of its motion.
    """

    def __init__(self, rate_hz: float, stream: str | None = None) -> None:
        self.stationary = False
        self.stationary_detection = True
        self.in_shell = stream is not None
        self.stream = stream
        self._last_command = stream or ""
        self._tenths, self._tenths_at_rest = max(1, round(10.0 / rate_hz)), 100
        self._input = bytearray()
        self._cr_ns: int | None = None
        self._published_ns: int | None = None
        self._location: tuple[Sequence[AnchorReport], TagFix | None] = ((), None)

    @property
    def rate_hz(self) -> float:
        """Update rate when moving [Hz], as `aurs` has set it."""
        return 10.0 / self._tenths

    def cycle(self, anchors: Sequence[AnchorReport], fix: TagFix | None, t_ns: int) -> bytes:
        """A new location is ready; returns the lines that a running stream prints for it."""
        at_rest = self.stationary and self.stationary_detection
        due_ns = (self._published_ns or 0) + self._tenths_at_rest * 100_000_000
        if at_rest and self._published_ns is not None and t_ns < due_ns:
            return b""
        self._published_ns = t_ns
        self._location = (anchors, fix)
        match self.stream:
            case "lec":
                return encode_lec(anchors, fix)
            case "les" if anchors:
                return encode_les(anchors, fix)
            case "lep" if fix is not None:
                return encode_lep(fix)
        return b""

    def receive(self, data: bytes, t_ns: int) -> bytes:
        """What the module answers to `data`."""
        answer = b""
        for byte in data:
            answer += self._shell(byte) if self.in_shell else self._tlv(byte, t_ns)
        return answer

    def _tlv(self, byte: int, t_ns: int) -> bytes:
        self._input.append(byte)
        if byte == POLL[0] and len(self._input) == 1:
            return b""
        request = bytes(self._input)
        self._input.clear()
        if request == POLL:
            return encode_location(*self._location)
        if byte != ord("\r"):
            return NOT_UNDERSTOOD
        if self._cr_ns is None or t_ns - self._cr_ns > ENTER_NS:
            self._cr_ns = t_ns
            return b""
        self._cr_ns, self.in_shell, self._last_command = None, True, ""
        return NOT_UNDERSTOOD + BANNER + PROMPT

    def _shell(self, byte: int) -> bytes:
        if byte != ord("\r"):
            self._input.append(byte)
            return bytes((byte,))
        command = self._input.decode("ascii", "replace").strip() or self._last_command
        self._input.clear()
        self._last_command = command
        answer = b"\r\n" + self._run(command.split())
        return answer + PROMPT if self.in_shell else answer

    def _run(self, words: list[str]) -> bytes:
        match words:
            case []:
                return b""
            case [("lec" | "lep" | "les") as stream]:
                self.stream = None if self.stream == stream else stream
                return b""
            case ["quit" | "reset"]:
                self.in_shell, self.stream = False, None
                return b""
            case ["aurs", rate, at_rest] if rate.isdigit() and at_rest.isdigit() and int(rate) > 0:
                self._tenths, self._tenths_at_rest = int(rate), int(at_rest)
                return b"aurs: ok\r\n"
            case ["acts", _, detection, *rest] if len(rest) == 7:
                self.stationary_detection = detection != "0"
                return b"acts: ok\r\n"
        return b"unknown command or arguments\r\n"
