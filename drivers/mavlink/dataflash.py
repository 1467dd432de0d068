"""ArduPilot's dataflash log (.BIN) as inertial samples and attitudes: a thin reader on pymavlink's DFReader.

IMU becomes ImuSample (rad/s and m/s^2 in the log already; `source` "IMU0", "IMU1", ... by instance), ATT
becomes Attitude (degrees in the log, heading 0..360). ATT holds no angular rates: they are those of the
latest RATE (deg/s in the log); attitudes before the first RATE wait for it. Stamps are the autopilot's own
clock: t_ns = t_rx_ns = TimeUS * 1000. Source: https://ardupilot.org/rover/docs/logmessages.html
"""

from __future__ import annotations

from collections.abc import Iterator
from math import radians
from pathlib import Path
from typing import Any

from pymavlink import DFReader

from companion.core.messages import Attitude, ImuSample

_MAGIC = b"\xa3\x95"
_KINDS = ["IMU", "ATT", "RATE"]


def read_dataflash(path: Path) -> Iterator[ImuSample | Attitude]:
    """Messages of the log at `path` in its order. OSError where it cannot be read.

    ValueError names the file where it is no dataflash log, or has attitudes but no RATE.
    """
    with path.open("rb") as file:
        if file.read(len(_MAGIC)) != _MAGIC:
            raise ValueError(f"{path}: not a dataflash log: it does not begin with the bytes A3 95")
    held: list[Any] = []
    rates: tuple[float, float, float] | None = None
    with DFReader.DFReader_binary(str(path)) as log:
        while (m := log.recv_match(type=_KINDS)) is not None:
            kind = m.get_type()
            if kind == "IMU":
                yield _imu(m)
                continue
            if kind == "RATE":
                rates = (radians(m.R), radians(m.P), radians(m.Y))
            else:
                held.append(m)
            if rates is not None:
                yield from (_attitude(waiting, rates) for waiting in held)
                held.clear()
    if held:
        raise ValueError(f"{path}: ATT without RATE: the log tells no angular rates")


def _imu(m: Any) -> ImuSample:
    t_ns = m.TimeUS * 1000
    return ImuSample(
        t_ns=t_ns,
        t_rx_ns=t_ns,
        ax_m_s2=m.AccX,
        ay_m_s2=m.AccY,
        az_m_s2=m.AccZ,
        p_rad_s=m.GyrX,
        q_rad_s=m.GyrY,
        r_rad_s=m.GyrZ,
        source=f"IMU{m.I}",
    )


def _attitude(m: Any, rates: tuple[float, float, float]) -> Attitude:
    t_ns = m.TimeUS * 1000
    return Attitude(
        t_ns=t_ns,
        t_rx_ns=t_ns,
        phi_rad=radians(m.Roll),
        theta_rad=radians(m.Pitch),
        psi_rad=radians(m.Yaw),
        p_rad_s=rates[0],
        q_rad_s=rates[1],
        r_rad_s=rates[2],
    )
