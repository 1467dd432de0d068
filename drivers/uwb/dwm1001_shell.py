"""What to say to a DWM1001 so that it streams: a small state machine, time as an argument, no I/O.

    listen     look for a running stream; silence -> wake
    wake       CR CR enters the shell; wait for `dwm>`; repeated with one more CR (the first wakes a sleeper)
    configure  `acts ...` (stationary detection off, else 0.1 Hz at rest), `aurs n n`; a prompt after each
    look       is a stream running? silence -> send the stream command, and look again
               (at once after the banner: a shell that was only just entered streams nothing)
    run        lines arrive; silence -> listen

The stream command is a TOGGLE and a bare CR repeats the last command, so nothing is sent before listening,
and the command only after silence longer than two periods. A wrong guess stops the stream, which the next
look sees and undoes. `40 01 01` means that the module is not in the shell (it restarted): -> wake.
The module is never reset (a reset leaves the shell and has been seen to hang): `aurs` sets the rate at rest
too, so 1 Hz holds even where a firmware heeds `acts` only after its next reset.
"""

from __future__ import annotations

from typing import Literal

S_NS = 1_000_000_000
LISTEN_NS = 6 * S_NS // 5  # assumed: longer than one period at 1 Hz with its jitter
PROMPT_NS = S_NS  # assumed: the answer to a command takes tens of ms, writing its flash some hundred
SILENCE_NS = 5 * S_NS  # assumed: a running stream that is silent so long has stopped
ACTS = b"acts 0 0 0 1 0 1 1 2 0\r"  # second argument: stationary detection off

State = Literal["listen", "wake", "configure", "look", "run"]


class ShellDialog:
    """The dialogue for one module. `rate_hz`: 0.1-10; `command`: lec, lep or les."""

    def __init__(self, rate_hz: float, command: str) -> None:
        if not 0.1 <= rate_hz <= 10.0:
            raise ValueError(f"rate_hz of a DWM1001 must be 0.1 to 10, not {rate_hz}")
        tenths = round(10.0 / rate_hz)
        self._commands = (ACTS, b"aurs %d %d\r" % (tenths, tenths))
        self._command = command.encode("ascii") + b"\r"
        period_ns = tenths * S_NS // 10
        self._look_ns = max(5 * period_ns // 2, 5 * S_NS // 2)
        self._silence_ns = max(5 * period_ns, SILENCE_NS)
        self.restart()

    def restart(self) -> None:
        """The port was opened: begin by listening."""
        self._enter("listen", None)
        self._attempts = 0
        self._entered = False

    @property
    def state(self) -> State:
        """Where the dialogue stands."""
        return self._state

    def _enter(self, state: State, t_ns: int | None) -> None:
        self._state: State = state
        self._since: int | None = t_ns
        self._prompt = False
        self._sent = 0

    def heard_stream(self, t_ns: int) -> None:
        """A good line arrived. In mid-configuration it only waits for the look."""
        if self._state in ("listen", "look", "run"):
            self._enter("run", t_ns)

    def heard_prompt(self) -> None:
        """`dwm>` arrived and nothing after it."""
        self._prompt = True

    def heard_banner(self) -> None:
        """The shell was entered just now: whatever streamed before has ended with the mode before."""
        self._entered = True

    def heard_not_in_shell(self) -> None:
        """`40 01 01` arrived: what we typed was taken for a TLV request."""
        if self._state in ("configure", "look"):
            self._enter("wake", None)

    def step(self, t_ns: int) -> list[bytes]:
        """What to send now."""
        fresh = self._since is None
        since = t_ns if self._since is None else self._since
        self._since = since
        waited = t_ns - since
        match self._state:
            case "listen" if waited >= LISTEN_NS:
                return self._wake(t_ns)
            case "wake" if self._prompt:
                self._attempts = 0
                self._enter("configure", t_ns)
                return self._next_command(t_ns)
            case "wake" if fresh or waited >= PROMPT_NS:
                return self._wake(t_ns)
            case "configure" if self._prompt or waited >= PROMPT_NS:
                return self._next_command(t_ns)
            case "look" if waited >= self._look_ns:
                self._enter("look", t_ns)
                return [self._command]
            case "run" if waited >= self._silence_ns:
                self._enter("listen", t_ns)
        return []

    def _wake(self, t_ns: int) -> list[bytes]:
        self._enter("wake", t_ns)
        self._entered = False
        self._attempts += 1
        return [b"\r"] * (2 if self._attempts == 1 else 3)

    def _next_command(self, t_ns: int) -> list[bytes]:
        if self._sent == len(self._commands):
            self._enter("look", t_ns)
            entered, self._entered = self._entered, False
            return [self._command] if entered else []
        command = self._commands[self._sent]
        self._sent, self._since, self._prompt = self._sent + 1, t_ns, False
        return [command]
