"""Draw figures like the paper's 11 to 18: its NMPC on its own model.

python -m sim.studies.paper.figures --out docs/figures
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np

from companion.boat.load_run import EXAMPLES
from companion.core.model.load_vessel import load_vessel
from companion.core.model.thrusters import configuration_matrix
from sim.bench.controller.paper_problem import PAPER
from sim.fitting.taylor.abkowitz import AbkowitzModel
from sim.studies.paper.closed_loop import ACCEPTANCE_M, WAYPOINTS, PaperTrack, metrics, run, variants

CASES = {
    "paper": "s_c = 0.001, one action applied (Figures 13, 14)",
    "no_control_cost": "s_c = 0 (Figures 15, 16)",
    "two_actions": "s_c = 0.001, two actions applied (Figures 17, 18)",
    "no_control_cost_noisy": "s_c = 0, with noise on the estimate",
}
NAMES = ("front port", "front starboard", "rear port", "rear starboard")


def main() -> int:
    """Simulate the cases, draw the pictures, print the figures of merit as JSON."""
    parser = argparse.ArgumentParser(prog="python -m sim.studies.paper.figures", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder for the pictures; made if absent")
    parser.add_argument("--seed", type=int, default=1, help="of the noise on the estimate")
    args = parser.parse_args()
    try:
        import matplotlib  # noqa: PLC0415
    except ImportError:
        print("figures: matplotlib is needed: pip install -e '.[analysis]'", file=sys.stderr)
        return 2
    matplotlib.use("Agg")
    path = EXAMPLES / "boats/aritra.toml"
    vessel = load_vessel(path.read_text(encoding="utf-8"), name=path.name)
    model = AbkowitzModel(configuration_matrix(vessel), vessel.propulsion.lag_s)
    tracks = {
        name: run(model, settings, noise=np.random.default_rng(args.seed) if noisy else None)
        for name, (settings, noisy) in variants().items()
    }
    args.out.mkdir(parents=True, exist_ok=True)
    draw_track(tracks["paper"], args.out / "paper_track.png")
    draw_effort(tracks, args.out / "paper_effort.png")
    draw_turn(tracks, args.out / "paper_turn.png")
    print(json.dumps({name: metrics(track) for name, track in tracks.items()}, indent=2))
    return 0


def draw_track(track: PaperTrack, path: Path) -> None:
    """Figures 11 and 12: the track with its waypoints, and the surge speed."""
    from matplotlib import patches  # noqa: PLC0415
    from matplotlib import pyplot as plt  # noqa: PLC0415

    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.6), width_ratios=(1, 1.4))
    points = np.array(WAYPOINTS)
    left.plot(points[:, 1], points[:, 0], "k--o", lw=1, ms=4, label="waypoints")
    for north, east in points[1:]:
        left.add_patch(patches.Circle((east, north), ACCEPTANCE_M, fill=False, ec="0.6", lw=0.8))
    left.plot(track.eta[:, 1], track.eta[:, 0], "C0", label="track")
    left.set(xlabel="east [m]", ylabel="north [m]", title="Track (as Figure 11)", aspect="equal")
    left.set(xlim=(0, 30), ylim=(0, 30))
    left.legend()
    right.axhline(PAPER.u_des_m_s, color="k", ls="--", lw=1, label="wanted")
    right.plot(track.t_s, track.nu[:, 0], label="surge speed u")
    right.plot(track.t_s, track.nu[:, 1], "C7", lw=0.8, label="sway speed v")
    right.set(xlabel="t [s]", ylabel="[m/s]", title="Surge speed (as Figure 12)")
    right.legend()
    save(figure, path)


def draw_effort(tracks: dict[str, PaperTrack], path: Path) -> None:
    """Figures 13, 15, 17: thrust of the four thrusters over the whole run."""
    from matplotlib import pyplot as plt  # noqa: PLC0415

    figure, axes = plt.subplots(len(CASES), 1, figsize=(11, 10), sharex=True)
    for axis, (case, title) in zip(axes, CASES.items(), strict=True):
        thrust_lines(axis, tracks[case], slice(None))
        axis.set(title=title, ylabel="thrust [kgf]")
    axes[-1].set(xlabel="t [s]")
    axes[0].legend(ncols=4, loc="lower right", fontsize=8)
    save(figure, path)


def draw_turn(tracks: dict[str, PaperTrack], path: Path) -> None:
    """Figures 14, 16, 18: the same, from 1 s before the first turn to 7 s after."""
    from matplotlib import pyplot as plt  # noqa: PLC0415

    figure, axes = plt.subplots(2, 2, figsize=(11, 7.5))
    for axis, (case, title) in zip(axes.flat, CASES.items(), strict=True):
        track = tracks[case]
        turn = int(np.argmax(track.leg > 0))
        thrust_lines(axis, track, slice(max(0, turn - 10), turn + 70), marker=".")
        axis.set(title=title, xlabel="t [s]", ylabel="thrust [kgf]")
    axes.flat[0].legend(fontsize=8)
    save(figure, path)


def thrust_lines(axis, track: PaperTrack, part: slice, **style) -> None:
    """Steps of thrust of each thruster, and the limits. Fore and aft of one side coincide: C_y = 0."""
    widths = (3.0, 3.0, 1.0, 1.0)
    for i, name in enumerate(NAMES):
        axis.step(track.t_s[part], track.c_kgf[part, i], where="post", lw=widths[i], ms=4, label=name, **style)
    for limit in (PAPER.c_min_kgf, PAPER.c_max_kgf):
        axis.axhline(limit, color="0.6", lw=0.8, ls=":")


def save(figure, path: Path) -> None:
    """Write a picture, and its name to standard error."""
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    print(path, file=sys.stderr)


if __name__ == "__main__":
    raise SystemExit(main())
