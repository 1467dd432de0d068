"""Evidence for the main job: the boat drives a mission in the loopback."""

from __future__ import annotations

import json
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import msgspec
import numpy as np
from scipy.stats import chi2

from companion.boat.load_run import EXAMPLES, load_setup
from companion.cli.simulator.demo import free_port
from companion.core.control.nmpc import Actuation, Nmpc
from companion.core.messages import (
    Alert,
    GroundTruth,
    GuidanceReference,
    OperatorCommand,
    OverrideLease,
    StateEstimate,
    Tick,
)
from companion.core.model.manoeuvring import StructuredModel
from companion.core.model.thrusters import configuration_matrix
from companion.core.pilot.pilot import Pilot
from companion.jit import compile_loops
from companion.logs.log_file import LogFile
from companion.python_child import aritra, python
from sim.fitting.taylor.abkowitz import AbkowitzModel
from sim.studies.paper.closed_loop import evidence as paper_evidence
from sim.studies.ranging.range_runs import range_filter_scores
from sim.world.environment import Weather
from sim.world.score import estimation, station, track_of, tracking
from sim.world.stepped import SteppedRun, SteppedWorld
from sim.world.stepped_controller import PATIENT_S
from sim.world.world import World, WorldSetup
from tests.evidence.line import Line, at_least, at_most, between, exactly
from tests.evidence.processes import processes

ROOT = Path(__file__).resolve().parents[3]
SEEDS = range(1, 21)
LIMIT_S = 240.0
SETTLE_S = 3.0
"""The mission is done once the boat has been within 0.3 m and 5 degrees, as it believes, for so long."""
STATION_S = 30.0
"""Station keeping is judged, against the truth, over so long from then on."""


@cache
def reference_boat():
    setup = load_setup(EXAMPLES / "aritra.toml").pilot
    vessel = setup.vessel
    model, patient = StructuredModel.of(vessel), msgspec.structs.replace(setup.nmpc, rescue_time_s=PATIENT_S)
    return (
        setup,
        Pilot(setup),
        Nmpc(model, Actuation.of(vessel), patient, time.perf_counter, setup.fence, compile_loops),
    )


def world_of(seed: int, disturbed: bool) -> World:
    """Start within 0.5 m and 35 degrees; disturbed: directions of current and wind from the seed."""
    setup, _, _ = reference_boat()
    rng = np.random.default_rng([seed, 7])
    north, east, psi = 8 + rng.uniform(-0.5, 0.5), 8 + rng.uniform(-0.5, 0.5), rng.uniform(-0.6, 0.6)
    towards, wind_from = rng.uniform(0, 360, 2)
    weather = Weather(V_c_m_s=0.1, beta_c_deg=towards, V_w_m_s=3.0, beta_w_deg=wind_from, gustiness=0.2)
    return World(
        WorldSetup(
            setup.vessel,
            setup.site,
            start=(north, east, psi),
            weather=weather if disturbed else Weather(),
            mismatch=0.1 if disturbed else 0.0,
        ),
        seed,
    )


def drive(case: tuple[int, bool]) -> dict[str, float]:
    """One mission on the stepped clock; its figures."""
    return drive_mission(world_of(*case))


def drive_mission(world: SteppedWorld, wait_s: float = 0.0) -> dict[str, float]:
    """The demo's mission in this world on the stepped clock, begun after `wait_s` in neutral; its figures."""
    setup, pilot, nmpc = reference_boat()
    run = SteppedRun(world, pilot, nmpc.solve, begin=None)
    run.run(lambda run: False, wait_s)
    run.feed([OperatorCommand(t_ns=world.t_ns, command="start")])

    def finished(run: SteppedRun) -> bool:
        settled = run.state.guidance.settled_ns
        done = run.state.guidance.phase == "done" and settled is not None
        return done and run.world.t_ns - settled > (SETTLE_S + STATION_S) * 1e9

    run.run(finished, LIMIT_S)
    track = track_of(run.of(StateEstimate), run.of(GuidanceReference), run.of(GroundTruth))
    points = np.array(setup.mission.path.points)
    last = points[-1] - points[-2]
    figures = tracking(track, points) | estimation(track)
    figures |= station(track, (*points[-1], float(np.arctan2(last[1], last[0]))), STATION_S)
    figures["missed"] = len(points) - len(run.state.guidance.passed)
    if figures["missed"]:
        said = [f"{m.t_ns * 1e-9:.1f} s: {m.text}" for m in run.of(Alert)[-5:]]
        print(f"  (a mission ended in {run.state.helm.mode}: {'; '.join(said)})", flush=True)
    away = np.linalg.norm(track.truth[:, None, :2] - points, axis=2).min(axis=0)
    figures["farthest_m"] = float(away.max())
    figures["unleased"] = float([m.index for m in run.of(Tick)] != [m.index for m in run.of(OverrideLease)])
    figures["simulated_s"] = run.world.t_ns * 1e-9
    return figures


def missions(full: bool) -> Iterator[Line]:
    """Missions: seeds 1-20 on the stepped clock, calm; then 0.1 m/s current, 3 m/s wind, plant off by 10 %"""
    with processes() as pool:
        for name, disturbed, cross_goal in (("calm", False, 0.15), ("disturbed", True, 0.25)):
            started = time.monotonic()
            runs = list(pool.map(drive, [(seed, disturbed) for seed in SEEDS]))
            yield from _mission_lines(name, runs, cross_goal)
            simulated = sum(r["simulated_s"] for r in runs)
            print(f"  ({name}: {simulated:.0f} s simulated in {time.monotonic() - started:.0f} s)")


def _mission_lines(name: str, runs: list[dict[str, float]], cross_goal: float) -> Iterator[Line]:
    def worst(key: str) -> float:
        return max(r[key] for r in runs)

    def note(key: str) -> str:
        return f"worst of 20; median {np.median([r[key] for r in runs]):.3f}"

    def pooled(key: str) -> float:
        return float(np.sqrt(np.mean([r[key] ** 2 for r in runs])))

    yield exactly(f"{name}: waypoints missed, all runs", sum(r["missed"] for r in runs), 0)
    far = worst("farthest_m")
    yield at_most(f"{name}: true distance to the worst-passed waypoint", far, 0.6, "m", note("farthest_m"))
    yield exactly(f"{name}: runs in which ticks and leases differ", sum(r["unleased"] for r in runs), 0)
    for key, goal, unit in (
        ("cross_track_rms_m", cross_goal, "m"),
        ("overshoot_m", 0.6, "m"),
        ("surge_rms_error_m_s", 0.05, "m/s"),
        ("station_error_m", 0.3, "m"),
        ("station_error_deg", 5.0, "deg"),
    ):
        yield at_most(f"{name}: {key}", worst(key), goal, unit, note(key))
    for key, goal, unit in (
        ("position_rmse_m", 0.10, "m"),
        ("u_rmse_m_s", 0.05, "m/s"),
        ("v_rmse_m_s", 0.05, "m/s"),
        ("heading_rmse_deg", 2.0, "deg"),
    ):
        yield at_most(f"{name}: {key}, pooled over 20 runs", pooled(key), goal, unit, f"worst run {worst(key):.3f}")
    band = chi2.ppf([0.025, 0.975], 6 * len(runs)) / len(runs)
    nees = float(np.mean([r["nees"] for r in runs]))
    yield between(f"{name}: NEES of [x y psi u v r], mean of 20 runs", nees, *band, note="95 % band of chi2(120)/20")


def demo(full: bool) -> Iterator[Line]:
    """Demo: two processes in real time"""
    with tempfile.TemporaryDirectory() as folder:
        command = aritra("demo", "--out", folder)
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            print(done.stdout[-2000:], done.stderr[-2000:])
        yield exactly("aritra demo: exit code", done.returncode, 0)
        figures = json.loads((Path(folder) / "summary.json").read_text())
        log = LogFile(Path(folder) / "run.mcap")
        indices = {kind: [m.index for m in log.messages(kind)] for kind in (Tick, OverrideLease)}
        yield exactly("ticks and leases differ (1: yes)", float(indices[Tick] != indices[OverrideLease]), 0)
        for key, goal, unit in (
            ("lateness_p99_ms", 10.0, "ms"),
            ("latency_p99_ms", 30.0, "ms"),
            ("nmpc_p99_ms", 5.0, "ms"),
            ("cpu_percent", 35.0, "%"),
            ("rss_mb", 300.0, "MB"),
        ):
            yield at_most(key, figures[key], goal, unit)
        again = aritra("replay", f"{folder}/run.mcap")
        yield exactly(
            "replay of its log: exit code (0: no difference)", subprocess.run(again, check=False).returncode, 0
        )


def kill(full: bool) -> Iterator[Line]:
    """SIGKILL of the companion under way: what the log keeps"""
    with tempfile.TemporaryDirectory() as folder:
        port, uwb, log = free_port(), f"{folder}/uwb", Path(folder) / "run.mcap"
        program = aritra()
        sim = subprocess.Popen(
            [*program, "sim", "--udp-to", f"127.0.0.1:{port}", "--uwb", uwb], stdout=subprocess.DEVNULL
        )
        wires = ["--mavlink", f"udpin:127.0.0.1:{port}", "--uwb", f"serial:{uwb}:115200", "--log", str(log)]
        boat = subprocess.Popen([*program, "run", *wires, "--start"], stdout=subprocess.DEVNULL)
        _wait_until_driving(log)
        killed_ns = time.monotonic_ns()
        boat.send_signal(signal.SIGKILL)
        boat.wait()
        sim.terminate()
        sim.wait()
        recovered = Path(folder) / "recovered.mcap"
        code = subprocess.run([*program, "log", "recover", str(log), "-o", str(recovered)], check=False).returncode
        yield at_most("aritra log recover: exit code (1: damage was found)", code, 1)
        last_ns = max(m.t_ns for m in LogFile(recovered).messages(Tick))
        yield at_most("lost at the end of the recovered log", (killed_ns - last_ns) * 1e-9, 1.0, "s")
        code = subprocess.run([*program, "replay", str(recovered)], check=False).returncode
        yield exactly("replay of the recovered log: exit code", code, 0)


def _wait_until_driving(log: Path) -> None:
    """Until the log tells of a lease from a plan, and 5 s more; RuntimeError after a minute."""
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline:
        time.sleep(1.0)
        if log.exists() and any(m.source == "plan" for m in LogFile(log).messages(OverrideLease)):
            time.sleep(5.0)
            return
    raise RuntimeError(f"{log}: the boat did not begin to drive within a minute")


def paper(full: bool) -> Iterator[Line]:
    """The paper's preset on its own model (seed 1)"""
    setup, _, _ = reference_boat()
    model = AbkowitzModel(configuration_matrix(setup.vessel), setup.vessel.propulsion.lag_s)
    figures = paper_evidence(model)
    plain, two = figures["paper"], figures["two_actions"]
    noisy, no_cost = figures["paper_noisy"], figures["no_control_cost_noisy"]
    for name, f in figures.items():
        yield exactly(f"{name}: waypoints passed", f["waypoints_passed"], 4)
    yield between("mean surge on legs", plain["surge_mean_legs_m_s"], 0.45, 0.55, "m/s")
    yield at_most("cross-track on legs", plain["cross_track_rms_legs_m"], 0.15, "m")
    chatter = no_cost["thrust_step_rms_kgf"] / noisy["thrust_step_rms_kgf"]
    steps = f"rms step {noisy['thrust_step_rms_kgf']:.2f} -> {no_cost['thrust_step_rms_kgf']:.2f} kgf, noisy estimate"
    yield at_least("chatter at s_c = 0: thrust steps over those at 0.001", chatter, 3.0, "", steps)
    yield at_most("steps that undo the one before: one action applied", plain["thrust_reversals_share"], 0.1)
    yield at_least("steps that undo the one before: two actions applied", two["thrust_reversals_share"], 0.5)


def real_input(full: bool) -> Iterator[Line]:
    """Real input: ArduSub log, outdoor UWB ranges, MAVSDK and MAVProxy"""
    data = ROOT.parent / "shared" / "data"
    yield exactly("measured data beside the checkout (1: there)", float(data.is_dir()), 1)
    if data.is_dir():
        scores = range_filter_scores(data / "uwb_hanyang")
        for run in ("LOS", "NLOS"):
            for variant, goal in (("gated", 0.8), ("gated_without_bias", np.inf), ("ungated_without_bias", np.inf)):
                s = scores[run][variant]
                name = f"{run}: planar RMSE, {variant.replace('_', ' ')}"
                yield at_most(name, s["rmse_m"], goal, "m", f"p95 {s['p95_m']:.2f} m, largest {s['max_m']:.2f} m")
    for test in CLIENT_TESTS:
        command = python("-m", "pytest", "-q", "--no-header", test)
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        summary = done.stdout.strip().splitlines()[-1]
        bad = done.returncode != 0 or "skipped" in summary or "passed" not in summary
        yield exactly(f"{test}: failed or skipped", float(bad), 0, "", summary)


CLIENT_TESTS = (
    "tests/drivers/mavlink/test_real_log.py",
    "tests/sim/world/autopilot/test_mavsdk_client.py",
    "tests/sim/world/autopilot/test_mavproxy_client.py",
)
PARTS = (missions, demo, kill, paper, real_input)
