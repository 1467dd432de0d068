"""The benchmark measures what it says: solvers of one problem, one timing, honest ratios, growth, the machine."""

import io
from collections.abc import Callable
from functools import cache

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from companion.boat.load_run import EXAMPLES
from companion.core.control.nmpc import Actuation
from companion.core.model.load_vessel import load_vessel
from companion.core.model.thrusters import configuration_matrix
from companion.jit import machine as compiled
from sim.bench.controller import compare
from sim.bench.controller.nlp import Nlp
from sim.bench.controller.rounds import REHEARSAL_S, BenchClock, Solved, Timed, interleaved, replay, times_of
from sim.bench.controller.solvers import RtiPlanner
from sim.bench.growth.measure import with_thrusters
from sim.bench.growth.scaling_exponent import bend, exponent
from sim.bench.machine import cpu_model, machine
from sim.bench.request import BenchRequest
from sim.bench.result import Bench, BenchRow, BenchSettings, SolverRefused, read, write
from sim.bench.simulation import SIMULATED_S, STEP_S, commands, runners
from sim.bench.table import quantity, show, times

BOAT = EXAMPLES / "boats" / "aritra.toml"
seconds = st.floats(1e-6, 1e2)


@cache
def order() -> BenchRequest:
    return BenchRequest(
        load_vessel(BOAT.read_text(), name=BOAT.name), BOAT, ("production", "paper"), solves=6, rounds=1
    )


@pytest.mark.long
@pytest.mark.parametrize(("problem", "near"), [("production", 0.05), ("paper", 0.02)])
def test_every_solver_that_runs_here_solves_the_same_problem(problem, near):
    """First commands of six ticks of seed 1 within `near` [N, kgf] of IPOPT's; converged ones within a thousandth."""
    timed, refused = compare.compared(order(), problem)
    if not compiled.may_run_what_was_written():
        refused = {name: why for name, why in refused.items() if not name.startswith("RTI")}
    assert refused == {}
    assert len(timed) >= 6 and next(iter(timed)) == compare.IPOPT
    for name, t in timed.items():
        assert t.unsolved == 0, name
        within = near if "1 step" in name or "iteration" in name else near / 1000
        assert t.off(timed[compare.IPOPT], 100) < within, name


@pytest.mark.long
def test_a_solver_that_is_not_there_is_told_and_the_others_run(monkeypatch):
    def absent(*_args, **_options):
        raise RuntimeError("first line\nPlugin 'fatrop' is not found.")

    monkeypatch.setattr(compare.Nlp, "one_step", absent)
    asked = compare.recorded(order().world("paper"), 1, 1)
    planners, refused = compare.built(order().world("paper"), asked[0])
    assert refused == {"sqpmethod + hpipm, 1 step": "Plugin 'fatrop' is not found."}
    assert compare.IPOPT in [p.name for p in planners]


def test_without_machine_code_its_rows_are_refused_and_not_filled_by_the_interpreter(monkeypatch):
    monkeypatch.setattr(compiled, "may_run_what_was_written", lambda: False)
    world = order().world("paper")
    planners, refused = compare.built(world, compare.recorded(world, 1, 1)[0])
    assert set(refused) == {"RTI, 1 iteration", compare.OURS, "RTI, converged"}
    assert any("interpreted" in p.name for p in planners)


class SteppedTime:
    """A clock that stands still but for waiting, for what calls take, and for waits that end late."""

    def __init__(self, late_s: float = 0.0):
        self.now_s, self.late_s = 0.0, late_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds + self.late_s

    def call(self, word: str, takes_s: float, seen: list) -> Callable[[], None]:
        def run() -> None:
            seen.append((word, self.now_s))
            self.now_s += takes_s

        return run

    def clock(self) -> BenchClock:
        return BenchClock(lambda: self.now_s, self.sleep)


@pytest.mark.parametrize("late_s", [0.0, 0.003])
def test_calls_at_a_cadence_are_that_far_apart(late_s):
    """A wait that ends late delays its own call and no other."""
    stepped, seen = SteppedTime(late_s), []
    found = list(times_of([stepped.call("call", 0.004, seen)] * 6, every_s=0.02, clock=stepped.clock()))
    assert [took for took, _ in found] == pytest.approx([0.004] * 6)
    assert [at for _, at in seen] == pytest.approx([0.02 * k + late_s for k in range(1, 7)])


def test_a_rehearsal_lies_before_its_call_and_is_not_in_its_time():
    stepped, seen = SteppedTime(), []
    calls, rehearse = [stepped.call("call", 0.0005, seen)] * 4, stepped.call("again", 0.0005, seen)
    found = list(times_of(calls, every_s=0.02, rehearse=rehearse, clock=stepped.clock()))
    assert [word for word, _ in seen] == ["again", "call"] * 4
    assert [took for took, _ in found] == pytest.approx([0.0005] * 4)
    assert [b - a for (_, a), (_, b) in zip(seen[::2], seen[1::2], strict=True)] == pytest.approx([REHEARSAL_S] * 4)


def test_a_rehearsal_changes_no_plan():
    world = order().world("paper")
    planner, asked = RtiPlanner("RTI", Nlp(world.ocp), 0.1), compare.recorded(world, 1, 20)
    plans = []
    for rehearse in (lambda: None, planner.rehearse):
        planner.begin(*asked[0])
        plans.append([])
        for one in asked:
            rehearse()
            plan = planner.solve(*one)
            plans[-1].append((plan.c.tolist(), plan.cost))
    assert plans[0] == plans[1]


def test_a_replay_gives_time_command_and_success_of_every_state():
    class Plans:
        name = "half"

        def begin(self, x0, p, q):
            self.n = 0

        def solve(self, x0, p, q):
            self.n += 1
            return type("P", (), {"c": np.full((2, 3), float(self.n)), "solved": self.n % 2 == 0})

    asked = [(np.zeros(1), np.zeros(1), np.zeros(1))] * 4
    done = replay(Plans(), asked)  # type: ignore[arg-type]
    assert done.first[:, 0].tolist() == [1.0, 2.0, 3.0, 4.0] and done.solved.tolist() == [False, True, False, True]
    assert (done.seconds > 0).all()
    solved = Solved()
    solved.add(done)
    solved.add(done)
    assert solved.unsolved == 4 and solved.count == 8 and solved.off(solved) == 0.0


@given(st.lists(st.lists(seconds, min_size=1, max_size=30), min_size=1, max_size=6))
def test_the_fastest_round_is_never_slower_than_the_median_one(rounds):
    t = Timed([np.array(r) for r in rounds])
    for percentile in (0, 50, 99, 100):
        assert min(map(min, rounds)) <= t.fastest(percentile) <= t.median(percentile) <= max(map(max, rounds))
    assert t.median(50) <= t.median(99) and t.count == sum(map(len, rounds))


@given(st.lists(seconds, min_size=2, max_size=9), st.randoms())
def test_rounds_in_another_order_give_the_same_figures(values, random):
    shuffled = random.sample(values, len(values))
    a, b = (Timed([np.array([v]) for v in vs]) for vs in (values, shuffled))
    assert a.fastest(50) == b.fastest(50) and a.median(50) == b.median(50)


def test_rounds_are_interleaved():
    order_of_calls = []

    def made(name):
        return lambda: order_of_calls.append(name) or 1.0

    interleaved({name: made(name) for name in "abc"}, 2)
    assert "".join(order_of_calls) == "abcabc"


powers = st.floats(-1.0, 4.0)


@given(powers, st.floats(1e-3, 1e3))
def test_a_power_law_is_found_and_does_not_bend(power, factor):
    sizes = [10, 20, 40, 80, 160]
    values = [factor * s**power for s in sizes]
    assert exponent(sizes, values) == pytest.approx(power, abs=1e-6)
    assert bend(sizes, values) is None


@given(powers, st.floats(0.5, 2.0), st.sampled_from([4, 8, 16]))
def test_two_power_laws_bend_where_they_meet(power, more, at):
    sizes = [1, 2, 4, 8, 16, 32, 64]
    values = [s**power if s <= at else at**power * (s / at) ** (power + more) for s in sizes]
    assert bend(sizes, values) == at


@pytest.mark.parametrize("n", [2, 3, 4, 6, 8, 12])
def test_a_boat_of_many_thrusters_is_one(n):
    boat = with_thrusters(order().vessel, n)
    B = configuration_matrix(boat)
    assert B.shape == (3, n) and np.linalg.matrix_rank(B, tol=1e-6) == min(n, 3)
    assert Actuation.of(boat).force_min_n.shape == (n,)
    assert len({t.channel for t in boat.thrusters}) == n


def test_all_ways_to_simulate_end_in_the_same_place():
    steps = 200
    x0, given_n = np.zeros(10), commands(4, steps)
    states = {name: run(x0, given_n) for name, run in runners(order().vessel, steps).items()}
    one = next(iter(states.values()))
    assert one.shape == (steps, 10) and np.abs(one[-1, 3:6]).max() > 0.01 and SIMULATED_S / STEP_S == 6000
    for name, other in states.items():
        assert np.abs(other - one).max() < 1e-10, name


def test_the_processor_has_a_name_or_none_is_made_up():
    assert cpu_model("processor\t: 0\nmodel name\t: Some CPU 3\nprocessor\t: 1\nmodel name\t: Other\n") == "Some CPU 3"
    assert "Foundation" in cpu_model("processor: 0\nHardware\t: Foundation\n") or cpu_model("") != ""


def result() -> Bench:
    row = BenchRow(part="solvers", problem="paper", name="x", unit="us", p50=1.5, p99=2.0, count=3, off=0.1)
    settings = BenchSettings(
        vessel="a.toml", problems=("paper",), solves=3, rounds=1, cadence_solves=3, seed=1, only="", growth=False
    )
    return Bench(
        schema=1, program={}, begun_utc="", seconds=1.0, machine=machine(0.5), settings=settings, rows=(row,),
        refused=(SolverRefused(part="fit", problem="", name="y", why="no"),), growth=(),
    )  # fmt: skip


def test_a_result_fits_a_terminal_of_80_columns():
    out = Console(file=io.StringIO(), width=80)
    show(out, result())
    lines = out.file.getvalue().splitlines()
    assert max(map(len, lines)) <= 80 and any("1.50 us" in line for line in lines)
    assert any("not run: fit" in line for line in lines)


def test_a_result_comes_back_from_its_file_as_it_was(tmp_path):
    bench = result()
    write(tmp_path / "b.json", bench)
    assert read(tmp_path / "b.json") == bench
    assert set(msgspec.json.decode((tmp_path / "b.json").read_bytes())) == set(Bench.__struct_fields__)


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [(18.34, "us", "18.3 us"), (17_400.0, "us", "17.4 ms"), (231.4, "MB", "231 MB"), (0.5, "s", "0.50 s")],
)
def test_quantities_have_three_digits(value, unit, text):
    assert quantity(value, unit) == text


def test_ratios_have_two_digits_or_three():
    assert [times(r) for r in (None, 0.51, 1.0, 19.94, 482.4)] == ["", "0.51 x", "1.0 x", "19.9 x", "482 x"]
