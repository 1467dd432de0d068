"""Signals that ask a command to end."""

import signal
import threading

import pytest

from companion.cli.interrupts import ended_as_by_ctrl_c


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


def test_a_thread_can_run_a_command(number):
    done = []

    def command():
        with ended_as_by_ctrl_c():
            done.append(signal.getsignal(number))

    thread = threading.Thread(target=command)
    thread.start()
    thread.join()
    assert done == [signal.SIG_DFL]
