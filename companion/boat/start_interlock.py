"""The interlock: the autopilot's parameters that decide whether the boat stops, for as long as the run lasts.

A `start`, `hold`, `excite` or `manual` waits until they have been read, but only some seconds, and is dropped where one
of them refuses; `stop` never waits. They are read anew after the autopilot's reboot and after its silence, and watched
from then on (`drivers.mavlink.parameter_watch`): one that changes to what refuses takes the driving away
(`InterlockTrip`). The rows are those of `aritra check`. While several autopilots are heard and the run file does not
name ours, or two of one system id, nothing begins.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from msgspec.structs import replace

from companion.boat.load_run import RunSetup
from companion.core.messages import Alert, Heartbeat, InterlockTrip, Message, OperatorCommand
from companion.core.pilot.autopilot_state import is_alive
from companion.core.pilot.modes import Taken
from companion.core.preflight.autopilot import further_parameter_names, parameter_names, parameter_rows
from companion.core.preflight.rows import ParameterSet, Row
from companion.core.preflight.wiring import Companion, untold_functions
from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.parameter_reader import ParameterReader
from drivers.mavlink.parameter_watch import ParameterChange, ParameterWatch
from drivers.mavlink.session import TWINS

AMBIGUOUS = "several autopilots are heard, and nobody has said which is ours (mavlink.autopilot_system_id)"

WAITS_S = 10.0
"""How long a command waits (assumed): reading takes 6 s with the simulated autopilot, and what was wanted long before
need not be wanted in the moment in which one is plugged in."""
SWITCH_ON_S = 60.0
"""That of a run which begins by itself (`--start`): the autopilot may have been switched on with it (assumed)."""


class StartInterlock:
    """The interlock of one run. `refused`: rows for which nothing may start; `clear`: all was read, nothing refuses.

    `rows`: the whole table as last judged.
    """

    def __init__(self, codec: MavlinkCodec, companion: Companion) -> None:
        self.refused: list[Row] = []
        self.clear = False
        self.rows: list[Row] = []
        self._codec, self._companion = codec, companion
        self._reader: ParameterReader | None = None
        self._watch: ParameterWatch | None = None
        self._more = self._patient = False
        self._reboots = codec.clock.reboots
        self._heard_ns: int | None = None
        self._held: OperatorCommand | None = None
        self._held_until_ns = 0
        self._begun = False
        self._trips: list[InterlockTrip] = []
        self._alerts: list[Alert] = []

    def passes(self, command: OperatorCommand, waits_s: float = WAITS_S) -> bool:
        """Whether a command may go to the pilot now. One that may not yet is kept for `waits_s`: see `take_inputs`."""
        if self.clear and not is_alive(self._heard_ns, command.t_ns):
            self._forget()  # whatever is plugged in next is another autopilot
        if command.command == "stop":
            self._held = None
            return True
        if why := self.refusal:
            self._held = None
            self._say(command.t_ns, "error", f"{command.command} refused: {why}")
            return False
        if self.clear:
            self._held, self._begun = None, True
            return True
        self._held, self._held_until_ns = command, command.t_ns + round(waits_s * 1e9)
        self._say(command.t_ns, "info", f"{command.command} waits for the check of the autopilot's parameters")
        return False

    def step(self, messages: Sequence[Message], t_ns: int) -> list[bytes]:
        """Frames to send at `t_ns` [ns]. Call it with every batch of messages, and at 10 Hz if none come."""
        if self._held and t_ns > self._held_until_ns:
            what = "the autopilot's parameters" if self._reader else "an autopilot"
            self._say(t_ns, "warning", f"{self._held.command} expired: it waited for {what}; give it again")
            self._held = None
        heartbeat = any(isinstance(message, Heartbeat) for message in messages)
        silent = heartbeat and self._heard_ns is not None and not is_alive(self._heard_ns, t_ns)
        self._heard_ns = t_ns if heartbeat else self._heard_ns
        if silent or self._codec.clock.reboots != self._reboots:
            self._reboots = self._codec.clock.reboots
            self._forget()
        if self._watch is not None:
            return self._keep_watch(self._watch, messages, t_ns)
        if self._reader is None:
            if not heartbeat:
                return []
            self._reader = ParameterReader(self._codec.encoder, parameter_names(self._companion))
            self._more = self._patient = False
        frames = self._reader.step(messages, t_ns)
        if self._reader.done:
            frames += self._read(self._reader, t_ns)
        return frames

    @property
    def refusal(self) -> str | None:
        """Why nothing may start; None: no reason so far."""
        if self.refused:
            names = ", ".join(row.name for row in self.refused)
            return f"the boat might not stop, or not follow ({names}); `aritra check` says what to do"
        if self._begun:
            return None
        return TWINS if self._codec.clock.twins else AMBIGUOUS if self._codec.ambiguous else None

    @property
    def turns_away(self) -> bool:
        """Whether nothing may start, and nothing has been started in this run."""
        return self.refusal is not None and not self._begun

    def take_inputs(self, t_ns: int, taken: Taken | None) -> list[Message]:
        """What the pilot has to hear at `t_ns` [ns]: trips, and the command that waited, once it may go.

        One after which the thrusters were taken away (`taken`) is dropped.
        """
        inputs: list[Message] = [*self._trips]
        self._trips = []
        if self._held and taken and taken.t_ns >= self._held.t_ns:
            self._say(t_ns, "warning", f"{self._held.command} dropped: meanwhile {taken.why}; give it again")
            self._held = None
        if self._held and self.clear:
            held = replace(self._held, t_ns=t_ns)
            inputs += [held] if self.passes(held) else []
        return inputs

    def take_alerts(self) -> list[Alert]:
        """Alerts since the last call."""
        alerts, self._alerts = self._alerts, []
        return alerts

    def _forget(self) -> None:
        """Read everything anew."""
        self._reader, self._watch, self.refused, self.rows, self.clear = None, None, [], [], False

    def _read(self, reader: ParameterReader, t_ns: int) -> list[bytes]:
        """All that was asked for has been told, or will not be."""
        parameters = ParameterSet(reader.values)
        if not self._more:
            self._more = True
            reader.ask(further_parameter_names(parameters))
            if not reader.done:
                return reader.step((), t_ns)
        if parameters.get("SERVO1_FUNCTION") is None:
            self._reader = None  # no answer: ask again with the next heartbeat
            if self._held:
                self._say(t_ns, "warning", "the autopilot does not tell its parameters: still waiting, not starting")
            return []
        if untold := untold_functions(parameters):  # nobody knows what these outputs carry: only they are asked again
            if self._held and not self._patient:
                self._say(t_ns, "warning", f"the autopilot does not tell {', '.join(untold)}: still waiting")
            self._patient = True
            reader.ask(untold)
            return reader.step((), t_ns)
        names = (*parameter_names(self._companion), *further_parameter_names(parameters))
        self._watch = ParameterWatch(self._codec.encoder, reader.values, names)
        self._judge(reader.values, t_ns)
        if self.refused and self._held:
            self.passes(replace(self._held, t_ns=t_ns))
        if self.refused and self._begun:
            self._trips.append(InterlockTrip(t_ns=t_ns, why="; ".join(map(_told, self.refused))))
        return []

    def _judge(self, values: dict[str, float], t_ns: int) -> None:
        """Rows anew; what is not in order is said, unless it was said before."""
        before, self.rows = self.rows, list(parameter_rows(ParameterSet(values), self._companion))
        self.refused = [row for row in self.rows if row.level == "refuse"]
        self.clear = not self.refused
        for row in self.rows:
            if row.level != "ok" and row not in before:
                self._say(t_ns, "error" if row.level == "refuse" else "warning", _told(row))

    def _keep_watch(self, watch: ParameterWatch, messages: Iterable[Message], t_ns: int) -> list[bytes]:
        frames = watch.step(messages, t_ns)
        if changes := watch.take_changes():
            was_clear, before = self.clear, self.refused
            self._judge(watch.values, t_ns)
            new = [row for row in self.refused if row not in before]
            if new:
                self._trips.append(InterlockTrip(t_ns=t_ns, why=_trip(changes, new)))
            elif self.clear and not was_clear:
                self._say(t_ns, "info", f"{_list(changes)}: no parameter refuses a start any more")
        return frames

    def _say(self, t_ns: int, level, text: str) -> None:
        self._alerts.append(Alert(t_ns=t_ns, level=level, text=text))


def _told(row: Row) -> str:
    return f"{row.name} = {row.found}: {row.why} -> {row.fix}"


def _list(changes: Iterable[ParameterChange]) -> str:
    return ", ".join(map(str, changes))


def _trip(changes: Iterable[ParameterChange], rows: Iterable[Row]) -> str:
    return f"the autopilot's parameter {_list(changes)}: {'; '.join(map(_told, rows))}"


def companion_of(setup: RunSetup) -> Companion:
    """What the configured companion overrides."""
    control = setup.run.control
    return Companion(
        thrusters=tuple((c.name, c.channel) for c in setup.pilot.vessel.controls),
        still=control.neutral_channels,
        system_id=setup.run.mavlink.system_id,
        lease_s=control.lease_s,
        latency_s=control.latency_s,
        vision=setup.run.vision is not None,
    )
