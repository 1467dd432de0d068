"""Reader of the recordings of C/S Enterprise I (NTNU basin, motion capture, 20 Hz; CSV).

Commands u1..u5 in -1..1 become 1500 + 400 u [us], which deploy/boats/cse1.toml maps back. Rows with tracking_lost keep
their commands; their pose, which is zeros, is left blank, and so is a pose with the ship on its side, where the tracker
confused its markers. The propellers' speed is setting_vsp_speed; bt_power, height and set-points are kept as extra_
columns; nu1..nu6 are dropped: they are raw differences of the pose.
Source: github.com/NTNU-MCS/CS_EnterpriseI_archive.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl

from companion.core.constants import NEUTRAL_US
from companion.core.geometry.frames import wrapped
from companion.logs.readers.join import Stream, join
from companion.logs.readers.table import numbers
from companion.logs.readers.text_table import text_table
from companion.logs.runs.run import LogProblem, Run, RunError, RunMeta

THRUSTERS = ("port_surge", "port_sway", "starboard_surge", "starboard_sway", "bow")
SPAN_US = 400.0
BEYOND = 1.01  # the joystick's counts end at 1.0028 (observed)
_NEEDED = ("t", "x", "y", "phi", "theta", "psi", "u1", "u2", "u3", "u4", "u5", "tracking_lost")
CAPSIZED_RAD = 0.5  # the ship rolls by 0.06 rad at most (observed); beyond this she would not float
_EXTRA = ("z", "bt_power", "eta_d1", "eta_d2", "eta_d3")


def is_cse1(header: str) -> bool:
    """Whether `header` is the first line of such a CSV."""
    return {"t", "u1", "u5", "tracking_lost"} <= set(header.split(","))


def read_cse1(path: Path) -> Run:
    """Run of one recording. Raises RunError naming file, line and column, OSError."""
    texts = text_table(path)
    if missing := [name for name in _NEEDED if name not in texts.table.columns]:
        raise RunError(f"{path}: line {texts.header}: column {', '.join(missing)}: missing")
    table, notes = numbers(texts.table, str(path), texts.place)
    blank = table.select(pl.any_horizontal(pl.col(_NEEDED).is_null())).to_series()
    if blank.any():
        raise RunError(f"{path}: {texts.place(int(blank.arg_true()[0]))}: a field is blank, or no number")
    data = {name: table[name].to_numpy() for name in table.columns}
    beyond = np.abs(np.column_stack([data[f"u{i}"] for i in range(1, 6)])).max(axis=1) > BEYOND
    if beyond.any():
        raise RunError(
            f"{path}: {texts.place(int(beyond.argmax()))}: u1..u5: expected -1 to 1, or up to {BEYOND} by rounding"
        )
    t_ns = np.rint(data["t"] * 1e9).astype(np.int64)
    tracked = data["tracking_lost"] == 0
    upright = np.maximum(np.abs(data["phi"]), np.abs(data["theta"])) < CAPSIZED_RAD
    seen = tracked & upright
    pose = {
        "psi_rad": wrapped(data["psi"][seen]),
        "north_m": data["x"][seen], "east_m": data["y"][seen],
        "phi_rad": data["phi"][seen], "theta_rad": data["theta"][seen],
    }  # fmt: skip
    pwm = {f"pwm_{name}": NEUTRAL_US + SPAN_US * data[f"u{i}"] for i, name in enumerate(THRUSTERS, 1)}
    extra = {f"extra_{name}": data[name] for name in _EXTRA if name in data}
    mocap = "motion capture, basin axes; the point that it tracks stands for the body origin"
    meta = RunMeta(
        vessel="cse1",
        source=path.name,
        clock="recording, from its beginning",
        site="NTNU Marine Cybernetics basin",
        latency_s=None,
        tag_arm_m=(0.0, 0.0),
        columns={
            "pwm": "commands u1..u5 as 1500 + 400 u; 20 Hz, logged value of each instant",
            **dict.fromkeys(("psi_rad", "north_m", "east_m"), mocap),
        },
    )
    streams = [
        Stream("motion capture", t_ns[seen], pose),
        Stream("commands", t_ns, pwm, held=True),
        Stream("others", t_ns, extra),
    ]
    if "vsp_speed" in data:
        streams.append(Stream("settings", t_ns, {"setting_vsp_speed": data["vsp_speed"]}, held=True))
    return join(streams, meta).with_notes([*texts.notes, *notes, *_capsized(data["t"], tracked & ~upright)])


def _capsized(t_s: np.ndarray, wrong: np.ndarray) -> list[LogProblem]:
    if not wrong.any():
        return []
    text = f"{wrong.sum()} poses with the ship on her side or back: markers taken for one another; left blank"
    return [LogProblem(kind="not a number", text=text, t_s=float(t_s[wrong.argmax()] - t_s[0]), length_s=0.0)]
