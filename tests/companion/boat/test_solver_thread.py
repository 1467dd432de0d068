"""The solver's thread: one request at a time, and a rehearsal between two that changes nothing but the caches."""

import asyncio
import time

import pytest
from msgspec.structs import replace

from companion.boat.solver_thread import REHEARSED_S, SolverThread
from companion.core.messages import PlanResult, SolveRequest
from tests.companion.boat.app_fixture import Bench
from tests.support.drive_fixture import nmpc

QUICK = 1e-4


@pytest.fixture
def path(tmp_path):
    return tmp_path / "run.mcap"


def request(index):
    return SolveRequest(t_ns=index, index=index, x0=(), reference=(), disturbance_n=(), f_prev_n=())


class Told:
    """A solver that keeps what it was asked; its warm start is the index of the last request that went well."""

    def __init__(self, seconds=QUICK, status="ok", raises=()):
        self.asked, self._seconds, self._status, self._raises = [], seconds, status, raises

    def solve(self, request, warm):
        self.asked.append((request.index, warm))
        if len(self.asked) in self._raises:
            raise FloatingPointError("for the test")
        result = PlanResult(
            t_ns=request.t_ns, index=request.index, status=self._status, reason="", solve_time_s=self._seconds,
            iterations=1, cost=0.0, f_n=(), x=(),
        )  # fmt: skip
        return result, request.index


def play(solver, words):
    """What `on_result` was given; `words`: a number asks for that request, `again` rehearses."""
    results = []

    async def story():
        thread = SolverThread(solver, results.append)
        for word in words:
            if word == "again":
                thread.rehearse()
                continue
            count = len(results)
            assert thread.submit(request(word))
            while len(results) == count:
                await asyncio.sleep(0.001)
        thread.close()

    asyncio.run(story())
    return results


def test_a_rehearsal_asks_the_last_question_once_more_and_gives_no_result():
    solver = Told()
    results = play(solver, [0, "again", 1, "again", "again", 2])
    assert [r.index for r in results] == [0, 1, 2]
    assert solver.asked == [(0, None), (0, None), (1, 0), (1, 0), (2, 1)]


def test_nothing_is_rehearsed_before_the_first_request():
    solver = Told()
    assert [r.index for r in play(solver, ["again", 5])] == [5] and solver.asked == [(5, None)]


@pytest.mark.parametrize("solver", [Told(seconds=2 * REHEARSED_S), Told(status="not_converged"), Told(raises=(1,))])
def test_what_took_long_or_went_wrong_is_not_rehearsed(solver):
    play(solver, [0, "again", 1])
    assert [index for index, _ in solver.asked] == [0, 1]


def test_a_rehearsal_that_raises_concerns_nobody():
    solver = Told(raises=(2,))
    results = play(solver, [0, "again", 1])
    assert [r.status for r in results] == ["ok", "ok"] and solver.asked[-1] == (1, 0)


def test_while_a_request_is_being_solved_nothing_is_rehearsed():
    class Slow(Told):
        def solve(self, request, warm):
            time.sleep(0.05)
            return super().solve(request, warm)

    solver, results = Slow(), []

    async def story():
        thread = SolverThread(solver, results.append)
        thread.submit(request(0))
        thread.rehearse()
        assert not thread.submit(request(1))
        while not results:
            await asyncio.sleep(0.001)
        thread.close()

    asyncio.run(story())
    assert solver.asked == [(0, None)]


def test_the_boat_rehearses_each_request_before_the_next_tick(path):
    class Counting:
        def __init__(self):
            self.nmpc, self.asked = nmpc(), []

        def solve(self, request, warm):
            result, warm = self.nmpc.solve(request, warm)
            self.asked.append(request.index)
            return replace(result, solve_time_s=QUICK), warm

    solver = Counting()
    bench = Bench(path, solver)

    async def story(bench):
        await bench.drive()
        await bench.run(2.0)

    assert bench.scene(story) is None
    plans = [p.index for p in bench.of(PlanResult)]
    assert len(plans) > 20 and solver.asked[: 2 * 20] == [index for index in plans[:20] for _ in range(2)]
