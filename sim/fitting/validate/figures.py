"""Pictures like the paper's Figures 5 to 10, and growth of errors over the horizon; matplotlib without a display."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.thrusters import forces_from_pwm
from companion.logs.runs.run import Run
from sim.fitting.engine.smoothing import RATE_HZ, Smoothed
from sim.fitting.taylor.pipeline import PaperMotion
from sim.fitting.validate.divergence import Departure
from sim.fitting.validate.protocol import CHANNELS, STEP_S, UNITS
from sim.fitting.validate.study import BASELINE_NAMES, Validation

INK = "#222222"
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")  # Okabe and Ito: seen by everyone
GREYS = ("#777777", "#aaaaaa")
SPEED_LABELS = ("surge u [m/s]", "sway v [m/s]", "yaw rate r [rad/s]")


def colours(names: Sequence[str]) -> dict[str, str]:
    """One colour for each model, greys for the baselines."""
    models = [name for name in names if name not in BASELINE_NAMES]
    out = {name: COLOURS[i % len(COLOURS)] for i, name in enumerate(models)}
    return out | dict(zip(BASELINE_NAMES, GREYS, strict=True))


def training_log(run: Run, paper: PaperMotion | None, smoothed: Smoothed, seconds: float = 120.0) -> Figure:
    """Figures 5 and 6: a free-running track, and speeds before and after the Lanczos filter.

    `paper` None: smoothed speeds only. `seconds`: length of the track shown.
    """
    figure = Figure(figsize=(11, 5.2), layout="constrained")
    spec = figure.add_gridspec(3, 2, width_ratios=(1, 1.4))
    plan = figure.add_subplot(spec[:, 0])
    t0 = smoothed.t_s[0]
    span_s = min(seconds, smoothed.t_s[-1] - t0)
    t_p, place = run.samples("north_m", "east_m")
    early = t_p <= t0 + seconds
    plan.plot(place[early, 1], place[early, 0], ".", color="#bbbbbb", ms=4, label="measured positions, at the tag")
    part = smoothed.t_s <= t0 + seconds
    plan.plot(smoothed.eta[part, 1], smoothed.eta[part, 0], color=COLOURS[0], lw=1.3, label="smoothed, body origin")
    plan.set(xlabel="east [m]", ylabel="north [m]", title=f"Track of {span_s:.0f} s (as Figure 5)")
    plan.set_aspect("equal", adjustable="datalim")
    plan.legend(fontsize=8)
    for i, label in enumerate(SPEED_LABELS):
        ax = figure.add_subplot(spec[i, 1])
        if paper is not None:
            early = paper.t_s <= t0 + seconds
            ax.plot(paper.t_s[early], paper.nu_raw[early, i], color="#bbbbbb", lw=2.4, label="Kalman filter")
            ax.plot(paper.t_s[early], paper.nu[early, i], color=COLOURS[1], lw=1.1, label="after Lanczos")
        ax.plot(smoothed.t_s[part], smoothed.nu[part, i], color=COLOURS[0], lw=1.1, label="RTS smoother")
        ax.set_ylabel(label, fontsize=8)
        if i == 0:
            ax.set_title("Speeds (as Figure 6)")
    ax.set_xlabel("t [s]")
    figure.legend(*ax.get_legend_handles_labels(), loc="outside lower right", ncols=3, fontsize=8)
    return figure


def comparison(validation: Validation, window: int, vessel: VesselFile) -> Figure:
    """Figures 7 to 10: measured against simulated track, surge, sway, yaw rate in one window.

    Below them what was commanded, and the steady forces that it makes by the maps of `vessel`.
    """
    figure = Figure(figsize=(11, 8.6), layout="constrained")
    spec = figure.add_gridspec(5, 2, width_ratios=(1, 1.3))
    truth = validation.windows.truth[window]
    t = np.arange(len(truth)) / RATE_HZ
    plan = figure.add_subplot(spec[:4, 0])
    *speeds, pulses, forces = (figure.add_subplot(spec[i, 1]) for i in range(5))
    low, high = np.nanmin(truth, axis=0), np.nanmax(truth, axis=0)
    plan.plot(truth[:, 1], truth[:, 0], color=INK, lw=2.2, label="measured")
    plan.plot(truth[0, 1], truth[0, 0], "o", color=INK, ms=5)
    for i, ax in enumerate(speeds):
        ax.plot(t, truth[:, 3 + i], color=INK, lw=2.2)
        ax.set_ylabel(SPEED_LABELS[i], fontsize=8)
        margin = 0.5 * (high[3 + i] - low[3 + i]) + 1e-3
        ax.set_ylim(low[3 + i] - margin, high[3 + i] + margin)
        ax.set_title(f"as Figure {8 + i}", fontsize=8, loc="right", pad=2)
    colour = colours([s.name for s in validation.scores])
    for s, states in zip(validation.scores, validation.states, strict=True):
        if s.name in BASELINE_NAMES:
            continue
        x = np.where(np.isfinite(truth[:, :1]), states[window], np.nan)
        plan.plot(x[:, 1], x[:, 0], color=colour[s.name], lw=1.4, label=s.name)
        for i, ax in enumerate(speeds):
            ax.plot(t, x[:, 3 + i], color=colour[s.name], lw=1.2)
    middle, half = (low + high)[:2] / 2, 0.75 * max(*(high - low)[:2], 1.0)
    plan.set(xlim=(middle[1] - half, middle[1] + half), ylim=(middle[0] - half, middle[0] + half), aspect="equal")
    plan.set(xlabel="east [m]", ylabel="north [m]", title="Track from the dot on (as Figure 7)")
    plan.legend(fontsize=8)
    end_s = float(t[np.isfinite(truth[:, 0])][-1])
    _commands(pulses, forces, validation, window, vessel, end_s)
    for ax in (*speeds, pulses):
        ax.set_xlim(0, end_s)
        ax.tick_params(labelbottom=False)
    forces.set(xlim=(0, end_s), xlabel="t since the start of the window [s]")
    return figure


def _commands(
    pulses: Axes, forces: Axes, validation: Validation, window: int, vessel: VesselFile, end_s: float
) -> None:
    """Pulse widths of a window, and the steady forces that they make, a line for each thruster."""
    commands, steps = validation.windows.commands, round(end_s / STEP_S)
    t, volts = np.arange(steps) * STEP_S, commands.battery_v[window, :steps]
    for i, thruster in enumerate(vessel.thrusters):
        pwm, colour = commands.pwm_us[window, :steps, i], COLOURS[i % len(COLOURS)]
        pulses.step(t, pwm, where="post", lw=1.0, color=colour, label=thruster.name)
        f = forces_from_pwm(thruster, vessel.force_maps[thruster.force_map], pwm, volts)
        forces.step(t, f, where="post", lw=1.0, color=colour)
    pulses.set_ylabel("pulse [us]", fontsize=8)
    forces.set_ylabel("force [N]", fontsize=8)
    pulses.legend(
        fontsize=7, ncols=len(vessel.thrusters), loc="lower center", bbox_to_anchor=(0.5, 0.98), frameon=False
    )


def error_growth(validation: Validation) -> Figure:
    """Rms error of every channel over the horizon, a line for each model."""
    figure = Figure(figsize=(11, 3.0), layout="constrained")
    colour = colours([s.name for s in validation.scores])
    for i, channel in enumerate(CHANNELS):
        ax = figure.add_subplot(1, len(CHANNELS), i + 1)
        for s in validation.scores:
            shown = np.where(s.rms[channel] < 1e3, s.rms[channel], np.nan)
            style = "--" if s.name in BASELINE_NAMES else "-"
            ax.plot(s.horizons_s, shown, style, color=colour[s.name], lw=1.4, marker=".", label=s.name)
        ax.set(xscale="log", yscale="log", xlabel="horizon [s]")
        ticks = [h for h in (1, 2, 5, 10, 20, 60) if h in validation.scores[0].horizons_s]
        ax.set_xticks(ticks, [str(h) for h in ticks])
        ax.minorticks_off()
        ax.set_title(f"{channel} [{UNITS[channel]}]", fontsize=9)
    figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=len(validation.scores), fontsize=8)
    return figure


def divergence(departures: Sequence[Departure]) -> Figure:
    """Share of diverged runs, and median distance from the true position, over the horizon."""
    figure = Figure(figsize=(11, 3.4), layout="constrained")
    share, far = figure.subplots(1, 2)
    colour = colours([d.name for d in departures])
    for d in departures:
        style = "--" if d.name in BASELINE_NAMES else "-"
        share.plot(d.t_s, 100 * d.diverged, style, color=colour[d.name], label=d.name)
        finite = np.where(np.isfinite(d.position_m[:, 1]), d.position_m[:, 1], np.nan)
        far.plot(d.t_s, finite, style, color=colour[d.name])
    share.set(xlabel="t [s]", ylabel="runs diverged [%]", ylim=(-3, 103), title=f"{departures[0].runs} unseen runs")
    far.set(xlabel="t [s]", ylabel="median distance [m]", yscale="log", title="Distance from the true place")
    share.legend(fontsize=8)
    return figure


def png_base64(figure: Figure) -> str:
    """The picture as text for a data URI."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    return base64.b64encode(buffer.getvalue()).decode()
