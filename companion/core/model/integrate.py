"""From a model of nu_dot to a state that can be integrated: kinematics, thruster lag, Runge-Kutta.

    x = [x y psi | u v r | f_1 .. f_n]          NED pose [m, m, rad], body velocities, forces [N], angles [rad]
    eta_dot = R(psi) nu,   f_dot = (f_cmd - f) / T_lag

|f_dot| <= slew where the model has such a limit. f: thrusts, then angles of servos (`actuators`). Dead time is not a
state: callers delay f_cmd (`DelayLine`). `manoeuvring.StructuredModel` and `abkowitz.AbkowitzModel` are such models.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import casadi as ca
import numpy as np

from companion.core.geometry.frames import rotate
from companion.core.model.actuators.propulsion import ActuatorSet

ETA, NU, FORCES = slice(0, 3), slice(3, 6), slice(6, None)


class VesselModel(Protocol):
    """What the plant, the filter and the NMPC ask of a vessel model."""

    @property
    def B(self) -> np.ndarray:
        """Thruster configuration matrix, shape (3, n); columns of servos, which turn thrust, are 0."""
        ...

    @property
    def lag_s(self) -> float | np.ndarray:
        """First-order lag of f [s]: one number, or (n,)."""
        ...

    @property
    def slew_N_s(self) -> float | np.ndarray | None:
        """Limit on the rate of f [N/s, rad/s]: one number, (n,), or None."""
        ...

    @property
    def is_linear_in_f(self) -> bool:
        """Whether `thrust` is B f whatever the pose and velocity."""
        ...

    @property
    def actuators(self) -> ActuatorSet | None:
        """Its actuators, where any of them is steered; None: fixed thrusters, tau = B f."""
        ...

    def thrust(self, eta: Any, nu: Any, f: Any) -> Any:
        """Body force, shape (3,), of the actuators' states f (n,)."""
        ...

    def nu_dot(self, eta: Any, nu: Any, tau: Any) -> Any:
        """Acceleration, shape (3,), from pose, velocity and body force."""
        ...


def eta_dot(eta: Any, nu: Any) -> Any:
    """R(psi) nu, shape (3,)."""
    return ca.vertcat(*rotate(eta[2], nu[0], nu[1]), nu[2])


def state_rate(model: VesselModel, x: Any, f_cmd: Any, tau_ext: Any) -> Any:
    """dx/dt, shape (6 + n,). `f_cmd` [N] after the dead time; `tau_ext`: body force [N, N, N m]."""
    eta, nu, f = x[ETA], x[NU], x[FORCES]
    tau = model.thrust(eta, nu, f) + tau_ext
    f_dot = (f_cmd - f) / model.lag_s
    if model.slew_N_s is not None:
        f_dot = ca.fmax(ca.fmin(f_dot, model.slew_N_s), -model.slew_N_s)
    return ca.vertcat(eta_dot(eta, nu), model.nu_dot(eta, nu, tau), f_dot)


def rk4_step(rate: Callable[[Any, Any], Any], x: Any, h: Any, inputs: tuple[Any, Any, Any]) -> Any:
    """One step of the classic Runge-Kutta method of order 4 over `h` seconds: numpy arrays or CasADi expressions.

    `inputs`: what `rate(x, input)` -> dx/dt takes besides the state, at the start, the middle and the end of the step.
    """
    start, middle, end = inputs
    k1 = rate(x, start)
    k2 = rate(x + h / 2 * k1, middle)
    k3 = rate(x + h / 2 * k2, middle)
    k4 = rate(x + h * k3, end)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def rk4(rate: Callable[[Any], Any], x: Any, h: Any, steps: int = 1) -> Any:
    """State after `h` seconds in `steps` equal steps of `rk4_step`; `rate` maps x to dx/dt."""
    for _ in range(steps):
        x = rk4_step(lambda state, _: rate(state), x, h / steps, (None, None, None))
    return x


def step_function(model: VesselModel, h: float, steps: int = 1) -> ca.Function:
    """CasADi function (x, f_cmd, tau_ext) -> x after `h` seconds."""
    n = model.B.shape[1]
    x, f_cmd, tau_ext = ca.SX.sym("x", 6 + n), ca.SX.sym("f_cmd", n), ca.SX.sym("tau_ext", 3)
    x_next = rk4(lambda s: state_rate(model, s, f_cmd, tau_ext), x, h, steps)
    return ca.Function("step", [x, f_cmd, tau_ext], [x_next], ["x", "f_cmd", "tau_ext"], ["x_next"])


class BufferedStep:
    """`step_function` called through CasADi's buffer interface: no copies, about 10 us a call."""

    def __init__(self, function: ca.Function):
        buffer, call = function.buffer()
        self._buffer: Any = buffer
        self._call: Any = call
        shapes = [function.size1_in(i) for i in range(function.n_in())]
        self._in: list[Any] = [np.zeros(s) for s in shapes]
        self._out: Any = np.zeros(function.size1_out(0))
        for i, array in enumerate(self._in):
            self._buffer.set_arg(i, memoryview(array))
        self._buffer.set_res(0, memoryview(self._out))

    def __call__(self, *args: Any) -> np.ndarray:
        """Next state, shape (6 + n,), a fresh array."""
        for target, value in zip(self._in, args, strict=True):
            target[:] = value
        self._call()
        return self._out.copy()


class DelayLine:
    """Commands in, the command of `delay_ns` ago out; the first value holds before anything was sent."""

    def __init__(self, delay_ns: int, initial: tuple[float, ...]):
        self._delay_ns = delay_ns
        self._sent: list[tuple[int, tuple[float, ...]]] = [(-(1 << 62), initial)]

    def push(self, t_ns: int, value: tuple[float, ...]) -> None:
        """Record what was commanded at `t_ns`."""
        if value != self._sent[-1][1]:
            self._sent.append((t_ns, value))

    def at(self, t_ns: int) -> tuple[float, ...]:
        """The command that acts at `t_ns`; forgets what can no longer act."""
        due = t_ns - self._delay_ns
        while len(self._sent) > 1 and self._sent[1][0] <= due:
            self._sent.pop(0)
        return self._sent[0][1]

    def next_ns(self) -> int | None:
        """When another command than that of the last `at` acts; None: none has been sent."""
        return self._sent[1][0] + self._delay_ns if len(self._sent) > 1 else None
