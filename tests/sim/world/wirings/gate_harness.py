"""deploy/ardupilot/gate.lua in a Lua 5.3 interpreter, with the few bindings of ArduPilot that it uses.

The outputs follow the firmware's source: a pulse written with a time-out lasts that long, then the output is what
its scaled value says: SERVOn_TRIM for 0 where the function has an angle range, SERVOn_MIN where it has none.
A script that raises is never run again.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from lupa import lua53

from companion.cli.simulator.autopilot_options import FOLDER

SCRIPT = FOLDER / "gate.lua"
TRIM_US, MIN_US, NOTHING_US = 1500, 1100, 0
_BINDINGS = """
function bind(h)
  arming = {is_armed = function(self) return h.is_armed() end}
  vehicle = {get_mode = function(self) return h.get_mode() end}
  rc = {
    has_valid_input = function(self) return h.has_valid_input() end,
    get_pwm = function(self, channel) return h.get_pwm(channel) end,
  }
  gcs = {send_text = function(self, severity, text) h.send_text(severity, text) end}
  SRV_Channels = {
    find_channel = function(self, number) return h.find_channel(number) end,
    set_angle = function(self, number, angle) h.set_angle(number, angle) end,
    set_output_scaled = function(self, number, value) h.set_output_scaled(number, value) end,
    set_output_pwm_chan_timeout = function(self, output, us, ms) h.set_output_pwm_chan_timeout(output, us, ms) end,
  }
end
"""


@dataclass
class Gate:
    """The script and what it sees. `functions`: SERVOn_FUNCTION, output 1 first; `stuck`: bindings that raise."""

    armed: bool = True
    valid: bool = True
    mode: int = 0
    channels_us: dict[int, int] = field(default_factory=dict)
    functions: list[int] = field(default_factory=lambda: [94, 95, 96, 97])
    stuck: set[str] = field(default_factory=set)
    texts: list[tuple[int, str]] = field(default_factory=list)
    t_ms: int = 0

    def __post_init__(self):
        self._angle, self._scaled = set(), {}
        self._pulses: dict[int, tuple[int, int]] = {}
        lua = lua53.LuaRuntime(unpack_returned_tuples=True)
        lua.execute(_BINDINGS)
        lua.globals().bind(self)
        self._due_ms = 0
        self.next = lambda: lua.execute(SCRIPT.read_text(encoding="utf-8"))

    def run(self, ms: int) -> tuple[int, ...]:
        """Let time pass; the outputs then."""
        end_ms = self.t_ms + ms
        while self.next is not None and self._due_ms <= end_ms:
            self.t_ms = max(self.t_ms, self._due_ms)
            try:
                again = self.next()
            except lua53.LuaError:
                self.next = None
                break
            self.next, wait_ms = again
            self._due_ms = self.t_ms + wait_ms
        self.t_ms = end_ms
        return self.outputs_us

    @property
    def outputs_us(self) -> tuple[int, ...]:
        """What leaves now, output 1 first."""
        return tuple(self._output(index) for index in range(len(self.functions)))

    def _output(self, index: int) -> int:
        us, until_ms = self._pulses.get(index, (0, -1))
        if self.t_ms < until_ms:
            return us
        number = self.functions[index]
        if number not in self._scaled:
            return us or NOTHING_US  # a pulse over nothing stays
        return TRIM_US if number in self._angle else MIN_US

    # --- bindings ----------------------------------------------------------------------------------

    def _use(self, name: str) -> None:
        if name in self.stuck:
            raise RuntimeError(f"{name} failed")

    def is_armed(self) -> bool:
        self._use("is_armed")
        return self.armed

    def get_mode(self) -> int:
        self._use("get_mode")
        return self.mode

    def has_valid_input(self) -> bool:
        self._use("has_valid_input")
        return self.valid

    def get_pwm(self, channel: int) -> int | None:
        self._use("get_pwm")
        return self.channels_us.get(channel)

    def send_text(self, severity: int, text: str) -> None:
        assert len(text) <= 50
        self.texts.append((severity, text))

    def find_channel(self, number: int) -> int | None:
        return self.functions.index(number) if number in self.functions else None

    def set_angle(self, number: int, angle: int) -> None:
        assert angle > 0
        self._angle.add(number)

    def set_output_scaled(self, number: int, value: float) -> None:
        assert value == 0
        self._scaled[number] = value

    def set_output_pwm_chan_timeout(self, output: int, us: int, ms: int) -> None:
        self._use("set_output_pwm_chan_timeout")
        assert isinstance(us, int) and 0 <= output < len(self.functions), "the binding takes whole numbers"
        self._pulses[output] = us, self.t_ms + ms
