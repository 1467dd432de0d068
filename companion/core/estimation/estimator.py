"""The boat's extended Kalman filter: sensor messages in, StateEstimate out; pure in its state.

    x = [x y psi | u v r | X_d Y_d N_d | b_ax b_ay | b_gz | b_psi | phi theta | b_gx b_gy | c_gx c_gy c_gz | e_1 .. e_k]

The vessel model, driven by the thruster forces that the commands produce, predicts; what it leaves out (wind,
current, wrong coefficients) is the latent body force d. Every measurement is fused at its own stamp: one that
arrives late is inserted among the messages of the last second, and those after it are fused again.

    estimator = Estimator(vessel, site)
    state = estimator.initial()
    state, innovations = estimator.step(state, message)      # any sensor message, in any order
    state = estimator.command(state, t_ns, f_command_n)      # what was sent to the thrusters
    estimate = estimator.estimate(state, t_ns)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import msgspec
import numpy as np
from msgspec.structs import replace

from companion.core.configuration.site_file import Site
from companion.core.configuration.vessel_file import VesselFile
from companion.core.estimation.channel_fusion import ChannelFusion
from companion.core.estimation.command_history import TimedCommand, active_command, drop_expired, insert_command
from companion.core.estimation.filter_state import (
    B_ACCEL,
    B_GYRO,
    B_RANGE,
    BufferedMeasurement,
    FilterState,
    Result,
)
from companion.core.estimation.health import assess, is_settled
from companion.core.estimation.inertial import Inertial
from companion.core.estimation.kalman import KalmanEquations
from companion.core.estimation.model_confidence import update_confidence
from companion.core.estimation.prediction import Predictor
from companion.core.estimation.process import Process
from companion.core.estimation.ranging.uwb_fusion import UwbFusion
from companion.core.estimation.start import FilterStart, Starter, after_gap, counted
from companion.core.estimation.tuning import EstimatorTuning
from companion.core.geometry.frames import ssa
from companion.core.messages import (
    Attitude,
    ImuSample,
    Innovation,
    Measured,
    Message,
    StateEstimate,
    UwbPosition,
    UwbRanges,
)
from companion.core.model.actuators.propulsion import channels_of, common
from companion.core.model.manoeuvring import StructuredModel
from companion.core.sensors.sensor import PositionHealth
from companion.core.sensors.table import SensorTable, sensors_of

Fusion = Callable[[FilterState, Any], Result]
UNKNOWN_VARIANCE = 1e6
"""Diagonal of the covariance reported before the filter runs: nothing is known."""


class EstimatorState(msgspec.Struct, frozen=True):
    """State of the estimator, as a value.

    `history`: messages of the last second with the filter after each, oldest first; empty before the start.
    `refused`: number of messages not fused, by reason. `restarts`, `restart_reason`: re-initialisations.
    `zero_ns`: arrival of the first message of each aiding sensor, by its key; from it a drifting stamp drifts.
    """

    start: FilterStart
    commands: tuple[TimedCommand, ...]
    history: tuple[BufferedMeasurement, ...] = ()
    refused: Mapping[str, int] = msgspec.field(default_factory=dict)
    restarts: int = 0
    restart_reason: str = ""
    zero_ns: Mapping[str, int] = msgspec.field(default_factory=dict)


class Estimator:
    """Constant parts of the filter for one vessel at one site. Methods are pure in the state they get."""

    def __init__(
        self,
        vessel: VesselFile,
        site: Site,
        tuning: EstimatorTuning | None = None,
        limits: PositionHealth | None = None,
    ):
        """`limits`: of health, instead of those of the sensor of positions."""
        self.tuning = tuning or EstimatorTuning(model_error=vessel.model_error)
        sensors, model = vessel.sensors, StructuredModel.of(vessel)
        self.vessel, self.anchors = vessel, tuple(a.id for a in site.anchors) if sensors.uwb else ()
        self.sensors = sensors_of(sensors, site)
        self._limits = limits or self.sensors.limits
        errors = [error for sensor in self.sensors for error in sensor.error_states]
        self._dead_time_s = common([c.dead_time_s for c in channels_of(vessel)])
        process = Process(model, (sensors.imu.x_m, sensors.imu.y_m))
        algebra = KalmanEquations(B_RANGE + len(errors))
        self._predictor = Predictor(process, model, sensors.imu, self.tuning, algebra, errors)
        self._starter = Starter(site, sensors, self.tuning, self.sensors)
        inertial = Inertial(process, sensors.imu, self.tuning, algebra)
        self._fusions: dict[type[Message], Fusion] = {
            ImuSample: inertial.fuse_imu, Attitude: inertial.fuse_attitude, **_channels(self.sensors, algebra)
        }  # fmt: skip
        if sensors.uwb:
            uwb = UwbFusion(site, sensors.uwb, self.tuning, algebra)
            self._fusions |= {UwbRanges: uwb.fuse_ranges, UwbPosition: uwb.fuse_position}

    def initial(self) -> EstimatorState:
        """State before any message; no force commanded yet."""
        neutral = TimedCommand(-(1 << 62), np.zeros(len(self.vessel.controls)))
        return EstimatorState(self._starter.initial(), (neutral,))

    def command(self, state: EstimatorState, t_ns: int, f_command_n: tuple[float, ...]) -> EstimatorState:
        """State after a command at t_ns: forces [N] and angles [rad] in the order of `vessel.controls`."""
        if not all(map(math.isfinite, f_command_n)):
            return _refuse(state, "command: not finite")
        commands = insert_command(state.commands, t_ns, f_command_n, self._dead_time_s)
        return replace(state, commands=commands if state.history else drop_expired(commands, t_ns))

    def step(self, state: EstimatorState, message: Message) -> tuple[EstimatorState, tuple[Innovation, ...]]:
        """State after one message, and what each of its numbers did. Other kinds of message change nothing.

        Never raises on what a sensor may send: what is not finite, a duplicate or too late is counted.
        """
        if (sensor := self.sensors.of(message)) is None:
            return state, ()
        good, problem = sensor.screen(message)
        if problem:
            state = _refuse(state, problem)
        if good is None:
            return state, ()
        good = sensor.correct(good)
        if sensor.aids and sensor.key not in state.zero_ns:
            state = replace(state, zero_ns={**state.zero_ns, sensor.key: good.t_ns})
        t_ns = self.instant_ns(good, state.zero_ns.get(sensor.key))
        if state.history and t_ns - state.history[-1].t_ns > self.tuning.restart_gap_s * 1e9:
            silence_s = (t_ns - state.history[-1].t_ns) * 1e-9
            state = self._restart(state, f"no sensor message for {silence_s:.0f} s", state.history[-1].belief.imu_ns)
        if not state.history:
            return self._begin(state, t_ns, good)
        return self._insert(state, t_ns, good)

    def instant_ns(self, m: Measured, zero_ns: int | None = None) -> int:
        """When a message of these sensors was measured; `zero_ns`: as in EstimatorState, None: it is the first."""
        return self.sensors[m].measured_ns(m, zero_ns)

    def _aids(self, m: Measured) -> bool:
        return self.sensors[m].aids

    def estimate(self, state: EstimatorState, t_ns: int, belief: FilterState | None = None) -> StateEstimate:
        """Pose of the body origin, velocities, biases, disturbance and health at t_ns; `belief`: then, if at hand."""
        belief = belief or self.belief(state, t_ns)
        if belief is None:
            return self._nothing(state, t_ns)
        x, (health, reason) = belief.x, assess(belief, t_ns, self.tuning, self._limits)
        return StateEstimate(
            t_ns=t_ns, north_m=float(x[0]), east_m=float(x[1]), psi_rad=ssa(float(x[2])),
            u_m_s=float(x[3]), v_m_s=float(x[4]), r_rad_s=float(x[5]),
            covariance=tuple(belief.P[:6, :6].ravel().tolist()), accel_bias_m_s2=tuple(x[B_ACCEL].tolist()),
            gyro_bias_rad_s=float(x[B_GYRO]),
            anchor_bias_m=dict(zip(self.anchors, x[B_RANGE : B_RANGE + len(self.anchors)].tolist(), strict=True)),
            disturbance_n=belief.latent_means.steady, health=health, reason=reason,
        )  # fmt: skip

    def belief(self, state: EstimatorState, t_ns: int) -> FilterState | None:
        """The filter predicted to t_ns (delivered forces included); None before initialisation."""
        if not state.history:
            return None
        entry = next((e for e in reversed(state.history) if e.t_ns <= t_ns), state.history[0])
        horizon_ns = entry.t_ns + round(self.tuning.restart_gap_s * 1e9)
        return self._predictor.to(entry.belief, min(t_ns, horizon_ns), state.commands)

    def _begin(self, state: EstimatorState, t_ns: int, m: Measured) -> tuple[EstimatorState, tuple[Innovation, ...]]:
        """Initialise by one message; the first filter state is the first entry of the history."""
        start, belief = self._starter.take(state.start, t_ns, m, active_command(state.commands, t_ns)[0])
        state = replace(state, start=start)
        if belief is None:
            return state, ()
        belief, innovations = self._fuse(belief, m)
        return replace(state, history=(BufferedMeasurement(t_ns, m, belief),)), innovations

    def _insert(self, state: EstimatorState, t_ns: int, m: Measured) -> tuple[EstimatorState, tuple[Innovation, ...]]:
        """Fuse at t_ns (what aids after all else of that instant), then fuse again what comes after it."""
        old = state.history
        place, aids = len(old), self._aids(m)
        while place > 0 and (old[place - 1].t_ns, self._aids(old[place - 1].message)) > (t_ns, aids):
            place -= 1
        if place == 0:
            return _refuse(state, "too late"), ()
        if _known(old[:place], t_ns, m):
            return _refuse(state, "duplicate"), ()
        try:
            new, innovations = self._replay(old[place - 1].belief, [(t_ns, m), *(e[:2] for e in old[place:])], state)
        except ValueError:  # numpy and filterpy raise it for numbers that are not finite or S not invertible
            new, innovations = (), ()
        if not (new and _sound(new[-1].belief)):
            return self._restart(state, "the filter's numbers were no longer finite"), innovations
        history = self._young((*old[:place], *new))
        return replace(state, history=history, commands=drop_expired(state.commands, history[0].t_ns)), innovations

    def _replay(
        self, belief: FilterState, messages: Sequence[tuple[int, Measured]], state: EstimatorState
    ) -> tuple[tuple[BufferedMeasurement, ...], tuple[Innovation, ...]]:
        """Entries for messages in order of time, and the innovations of the first."""
        entries, first = [], None
        for t_ns, m in messages:
            gap = t_ns - belief.t_ns > self.tuning.imu_timeout_s * 1e9
            belief = self._predictor.to(belief, t_ns, state.commands)
            belief, innovations = self._fuse(after_gap(belief, self.tuning) if gap else belief, m)
            entries.append(BufferedMeasurement(t_ns, m, belief))
            first = innovations if first is None else first
        return tuple(entries), first or ()

    def _fuse(self, belief: FilterState, m: Measured) -> Result:
        """Measurement update by a message of the filter state's own instant."""
        before = belief
        belief, innovations = self._fusions[type(m)](before, m)
        if not self._aids(m):
            return belief, innovations
        belief = update_confidence(belief, innovations, self.tuning)
        belief = counted(before, belief, self.tuning.settle_most_s / 2)
        return replace(belief, settled=is_settled(before, belief, self.tuning)), innovations

    def _young(self, history: tuple[BufferedMeasurement, ...]) -> tuple[BufferedMeasurement, ...]:
        """History without what is older than `history_s`, but for one entry to start a replay from."""
        oldest_ns = history[-1].t_ns - round(self.tuning.history_s * 1e9)
        first = 0
        while first + 1 < len(history) and history[first + 1].t_ns <= oldest_ns:
            first += 1
        return history[first:]

    def _restart(self, state: EstimatorState, reason: str, imu_ns: int | None = None) -> EstimatorState:
        """State to initialise from afresh; commands and counts are kept. `imu_ns`: as in FilterStart."""
        begun, count = self._starter.initial(imu_ns), state.restarts + 1
        return EstimatorState(begun, state.commands, (), state.refused, count, reason, state.zero_ns)

    def _nothing(self, state: EstimatorState, t_ns: int) -> StateEstimate:
        """The estimate before the start: zeros that say they mean nothing."""
        again = f" (started afresh: {state.restart_reason})" if state.restarts else ""
        return StateEstimate(
            t_ns=t_ns, north_m=0.0, east_m=0.0, psi_rad=0.0, u_m_s=0.0, v_m_s=0.0, r_rad_s=0.0,
            covariance=tuple((UNKNOWN_VARIANCE * np.eye(6)).ravel().tolist()), accel_bias_m_s2=(0.0, 0.0),
            gyro_bias_rad_s=0.0, anchor_bias_m=dict.fromkeys(self.anchors, 0.0),
            disturbance_n=(0.0, 0.0, 0.0), health="initialising", reason=state.start.reason + again,
        )  # fmt: skip


def _sound(belief: FilterState) -> bool:
    """Whether all numbers are finite and no variance is negative."""
    return belief.is_finite and bool((np.diagonal(belief.P) >= 0).all())


def _refuse(state: EstimatorState, reason: str) -> EstimatorState:
    """One more message refused for this reason."""
    return replace(state, refused={**state.refused, reason: state.refused.get(reason, 0) + 1})


def _channels(sensors: SensorTable, algebra: KalmanEquations) -> dict[type[Message], Fusion]:
    """How messages of sensors that have channels are fused."""
    fusions: dict[type[Message], Fusion] = {}
    first = B_RANGE
    for sensor in sensors:
        if sensor.channels:
            fusions |= dict.fromkeys(sensor.messages, ChannelFusion(sensor, first, algebra).fuse)
        first += len(sensor.error_states)
    return fusions


def _known(history: tuple[BufferedMeasurement, ...], t_ns: int, m: Measured) -> bool:
    """Whether a message of the same kind and origin already stands at this instant."""
    for entry in reversed(history):
        if entry.t_ns < t_ns:
            return False
        if type(entry.message) is type(m) and _origin(entry.message) == _origin(m):
            return True
    return False


def _origin(m: Measured) -> str:
    """Which device of its kind a message comes from."""
    return m.source if isinstance(m, ImuSample) else getattr(m, "tag", "")
