"""Signals that ask a command to end."""

import asyncio
import signal
import threading

import pytest

from companion.cli.interrupts import call_when_asked_to_end, ended_as_by_ctrl_c


@pytest.fixture(params=["SIGTERM", "SIGHUP"])
def number(request):
    number = getattr(signal, request.param)
    before = signal.signal(number, signal.SIG_DFL)
    yield number
    signal.signal(number, before)


def test_it_ends_as_by_ctrl_c_and_leaves_the_handlers_as_they_were(number):
    with pytest.raises(KeyboardInterrupt), ended_as_by_ctrl_c():
        signal.raise_signal(number)
    assert signal.getsignal(number) is signal.SIG_DFL


def test_what_is_ignored_stays_ignored(number):
    signal.signal(number, signal.SIG_IGN)
    with ended_as_by_ctrl_c():
        signal.raise_signal(number)
        assert signal.getsignal(number) is signal.SIG_IGN


@pytest.mark.parametrize(("before", "ends"), [(signal.SIG_IGN, False), (signal.SIG_DFL, True)])
def test_a_command_with_a_loop_ends_in_order_but_not_by_what_is_ignored(number, before, ends):
    """`nohup aritra run`: the terminal that closes is no reason to end a mission."""

    async def play():
        loop, ended = asyncio.get_running_loop(), asyncio.Event()
        call_when_asked_to_end(loop, ended.set)
        signal.raise_signal(number)
        await asyncio.sleep(0.05)
        for each in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            loop.remove_signal_handler(each)
        return ended.is_set()

    signal.signal(number, before)
    assert asyncio.run(play()) is ends


def test_a_thread_can_run_a_command(number):
    done = []

    def command():
        with ended_as_by_ctrl_c():
            done.append(signal.getsignal(number))

    thread = threading.Thread(target=command)
    thread.start()
    thread.join()
    assert done == [signal.SIG_DFL]
