"""Bugs in the core, in the shell and in the solver: the App ends in neutral, or goes on without them."""

from __future__ import annotations

import asyncio
import threading
import time

import pytest

from companion.boat.gcs_forward import GcsForward
from companion.core.messages import (
    OperatorCommand,
    OverrideLease,
    PlanResult,
    Tick,
)
from companion.core.pilot.pilot import Pilot
from tests.companion.boat.app.ending import ends_in_order
from tests.companion.boat.app.shell_faults import IN_THE_SHELL
from tests.companion.boat.app_fixture import Bench, S, neutral, released
from tests.support.stand_ins.memory_port import memory_pair


class Mind(Pilot):
    """A pilot that raises at a chosen tick."""

    fails_at: int | None = None

    def step(self, state, inputs, t_ns):
        if self.fails_at is not None and any(isinstance(i, Tick) and i.index >= self.fails_at for i in inputs):
            raise ZeroDivisionError("a bug in the core")
        return super().step(state, inputs, t_ns)


def after_failure(bench, error, kind):
    assert isinstance(error, kind)
    ends_in_order(bench)


def mind():
    from tests.support.drive_fixture import setup

    return Mind(setup().pilot)


def test_an_exception_in_the_core_ends_in_neutral_and_is_raised(path):
    bench = Bench(path, mind=mind())

    async def story(bench):
        await bench.drive()
        assert not neutral(bench.overrides[-1][1])
        bench.mind.fails_at = bench.of(Tick)[-1].index + 1
        failed_ns = bench.clock.now_ns()
        await bench.run(3.0, until=bench.running.done)
        assert 0.9 * S < bench.clock.now_ns() - failed_ns < 1.6 * S

    after_failure(bench, bench.scene(story), ZeroDivisionError)


@pytest.mark.parametrize(("fault", "driving"), IN_THE_SHELL)
@pytest.mark.long
def test_a_bug_anywhere_in_the_shell_ends_in_neutral_too(path, fault, driving, monkeypatch):
    bench = Bench(path)

    async def story(bench):
        await (bench.drive() if driving else bench.run(2.0))
        fault(bench, monkeypatch)
        assert await bench.run(4.0, until=bench.running.done)

    after_failure(bench, bench.scene(story), ValueError)


@pytest.mark.parametrize("raised", [SystemExit(0), KeyboardInterrupt(), asyncio.CancelledError(), GeneratorExit()])
def test_what_is_no_exception_ends_in_neutral_and_in_an_error(path, raised):
    """Exit code 0 would tell the service manager that all is well."""
    bench = Bench(path)

    async def story(bench):
        await bench.drive()

        def watch(message):
            if isinstance(message, Tick):
                bench.on_watch = None
                raise raised

        bench.on_watch = watch
        assert await bench.run(4.0, until=bench.running.done)

    error = bench.scene(story)
    assert isinstance(error, RuntimeError) and error.__cause__ is raised
    ends_in_order(bench)


def test_a_bug_in_what_shows_the_station_ends_in_neutral_too(path):
    class Station(GcsForward):
        def show_own(self, frame):
            if bench.of(Tick) and bench.mode == "auto":
                raise ValueError("a bug in the forward")

    bench = Bench(path, station=lambda clock: Station(memory_pair("station")[0], None, clock, lambda text: ()))

    async def story(bench):
        bench.app.command(OperatorCommand(t_ns=bench.clock.now_ns(), command="start"))
        assert await bench.run(25.0, until=bench.running.done)

    after_failure(bench, bench.scene(story), ValueError)


@pytest.mark.parametrize("whole_loop", [False, True])
def test_a_run_that_is_cancelled_ends_in_neutral_too(path, whole_loop):
    """As an event loop does with all its tasks when something breaks it."""
    bench = Bench(path)

    async def story(bench):
        await bench.drive()
        others = {asyncio.current_task(), *bench.ends}
        for task in asyncio.all_tasks() - others if whole_loop else (bench.running,):
            task.cancel()
        assert await bench.run(4.0, until=bench.running.done)

    assert isinstance(bench.scene(story), asyncio.CancelledError)
    ends_in_order(bench)


def test_one_that_is_cancelled_again_has_no_time_left_and_still_disarms(path):
    bench = Bench(path)

    async def story(bench):
        await bench.drive()
        bench.running.cancel()
        await bench.run(0.1)
        bench.running.cancel()
        assert await bench.run(1.0, until=bench.running.done)

    assert isinstance(bench.scene(story), asyncio.CancelledError)
    *_, before, last = (pwm for _, pwm in bench.overrides)
    assert neutral(before) and released(last)
    assert not bench.world.rover.vehicle.modes.armed


class Stuck:
    """A solver that does not come back until it is let go."""

    def __init__(self):
        self.gate = threading.Event()

    def solve(self, request, warm):
        self.gate.wait()
        raise AssertionError("let go")


def test_a_solver_that_never_returns_leaves_the_leases_to_the_ladder(path):
    solver = Stuck()
    bench = Bench(path, solver)

    async def story(bench):
        await bench.drive()
        await bench.run(2.0)

    started = time.monotonic()
    try:
        assert bench.scene(story) is None
    finally:
        solver.gate.set()
    assert time.monotonic() - started < 30.0
    assert set(bench.leases_per_tick()[:-12]) == {1}
    assert {lease.source for lease in bench.of(OverrideLease)} == {"neutral", "pd"}
    told = [text for text in bench.alerts() if "solver is still busy" in text]
    assert len(told) == 1, "said once, not at every tick"
    ends_in_order(bench)


class Raising:
    def solve(self, request, warm):
        raise FloatingPointError("no numbers today")


def test_a_solver_that_raises_has_failed_and_the_run_goes_on(path):
    bench = Bench(path, Raising())

    async def story(bench):
        await bench.drive()
        await bench.run(1.0)

    assert bench.scene(story) is None
    plans = bench.of(PlanResult)
    assert len(plans) > 10 and {p.status for p in plans} == {"failed"}
    assert all("FloatingPointError: no numbers today" in p.reason for p in plans)
    leases = [lease for lease in bench.of(OverrideLease) if lease.source != "neutral"]
    assert {lease.source for lease in leases} == {"pd"} and "FloatingPointError" in leases[0].reason
    assert set(bench.leases_per_tick()[:-12]) == {1}
    ends_in_order(bench)


def test_a_loop_that_stands_still_sends_neutral_when_the_lease_is_over(path):
    """Housekeeping speaks where the core does not."""
    bench = Bench(path, mind=mind())

    async def story(bench):
        await bench.drive()
        bench.mind.step = lambda state, inputs, t_ns: (state, [])
        last = bench.of(OverrideLease)[-1]
        await bench.run(1.0)
        after = [(t_ns, pwm) for t_ns, pwm in bench.overrides if t_ns > last.t_ns]
        assert len(after) >= 5 and all(neutral(pwm) for _, pwm in after)
        assert 0.3 * S <= after[0][0] - last.t_ns <= 0.4 * S

    bench.scene(story)
