"""What the service manager is told, and the datagrams that carry it, over real sockets."""

import contextlib
import os
import socket

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.boat.systemd.notify import SdNotify
from companion.boat.systemd.status import (
    EXTEND_NS,
    STATUS_NS,
    ManagerState,
    Service,
    ServiceState,
    due_lines,
    next_state,
    status_text,
)
from companion.core.messages import (
    ExcitationStatus,
    GuidanceReference,
    LinkStatus,
    LoopTiming,
    OverrideLease,
    Tick,
)

S = 1_000_000_000
PID = 4711


def timing(t_s, sent=True):
    return LoopTiming(t_ns=round(t_s * S), index=0, lateness_ms=0.0, imu_to_override_ms=None, sent=sent)


def lease(source="neutral", reason=""):
    return OverrideLease(
        t_ns=0,
        index=0,
        channels=(9,),
        pwm_us=(1500,),
        valid_for_s=0.3,
        source=source,
        reason=reason,
        f_command_n=(0.0,),
    )


def reference(phase="leg", passed=2):
    numbers = dict.fromkeys(GuidanceReference.__struct_fields__, 0.0)
    return GuidanceReference(**{**numbers, "t_ns": 0, "phase": phase, "waypoints_passed": passed})


@pytest.fixture
def notifier():
    """SdNotify that is closed in the end."""
    with contextlib.ExitStack() as stack:
        yield lambda environ: stack.enter_context(contextlib.closing(SdNotify(environ, PID)))


class Manager:
    """The far end of NOTIFY_SOCKET."""

    def __init__(self, name):
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind("\0" + name[1:] if name.startswith("@") else name)
        self.socket.setblocking(False)
        self.environ = {"NOTIFY_SOCKET": name}

    def lines(self):
        found = []
        while True:
            try:
                found += self.socket.recv(65536).decode().split("\n")
            except BlockingIOError:
                return found


@pytest.fixture(params=["path", "abstract"])
def manager(request, tmp_path):
    made = Manager(str(tmp_path / "notify") if request.param == "path" else f"@aritra-test-{os.getpid()}")
    yield made
    made.socket.close()


# --- when ------------------------------------------------------------------------------------------


@given(
    leases=st.lists(st.tuples(st.floats(0.0, 3.0), st.booleans()), max_size=60),
    watchdog_ns=st.none() | st.integers(1, 20 * S),
)
def test_ready_and_alive_are_said_after_leases_that_were_sent_and_only_then(leases, watchdog_ns):
    said, t, pets, readies = ManagerState(), 0.0, [], 0
    for gap_s, sent in leases:
        t += gap_s
        said, lines = due_lines(said, ServiceState(), timing(t, sent), watchdog_ns)
        if not sent:
            assert not {"READY=1", "WATCHDOG=1"} & set(lines)
        elif watchdog_ns:
            pets += [t] * lines.count("WATCHDOG=1")
            assert (t - pets[-1]) * S <= watchdog_ns / 4 + 1, "a lease goes out, and the watchdog starves"
        readies += lines.count("READY=1")
        assert said.ready == bool(readies) and not (readies and any("EXTEND" in line for line in lines))
    assert readies == any(sent for _, sent in leases)
    assert watchdog_ns or not pets


def test_the_start_is_extended_while_the_wire_is_closed_and_no_longer():
    said, told = ManagerState(), []
    for tenth in range(300):
        said, lines = due_lines(said, ServiceState(), timing(tenth / 10, sent=False), 10 * S)
        told += [tenth / 10 for line in lines if line == "EXTEND_TIMEOUT_USEC=60000000"]
    assert told == [0.0, 10.0, 20.0] and EXTEND_NS == 10 * S
    said, _ = due_lines(said, ServiceState(), timing(30.0), 10 * S)
    for tenth in range(310, 600):
        said, lines = due_lines(said, ServiceState(), timing(tenth / 10, sent=False), 10 * S)
        assert not any(line.startswith(("EXTEND", "WATCHDOG", "READY")) for line in lines)


def test_a_status_is_said_once_and_at_most_once_a_second():
    said, told = ManagerState(), []
    for tenth in range(100):
        said, lines = due_lines(
            said, next_state(ServiceState(), lease(reason=f"number {tenth // 3}")), timing(tenth / 10), None
        )
        told += [tenth / 10 for line in lines if line.startswith("STATUS=")]
    assert told == [float(i) for i in range(10)] and STATUS_NS == S
    for tenth in range(100, 130):
        said, lines = due_lines(said, next_state(ServiceState(), lease(reason="number 33")), timing(tenth / 10), None)
        told += lines
    assert told[10:] == ["STATUS=neutral: number 33"]


# --- in words --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("messages", "sent", "text"),
    [
        ([], True, "neutral"),
        ([lease(reason="waiting for the operator's start")], True, "neutral: waiting for the operator's start"),
        ([reference(), lease("plan")], True, "driving: leg, 2 waypoints passed"),
        ([reference("station", 5), lease("pd", "late")], True, "driving: station, 5 waypoints passed; fallback pd"),
        ([lease("plan")], True, "driving"),
        ([reference(), lease(reason="lost")], True, "neutral: lost"),
        (
            [
                ExcitationStatus(t_ns=0, phase="running", segment=1, segments=3, name="surge", elapsed_s=1.0),
                lease("excitation"),
            ],
            True,
            "excitation: running, segment 2 of 3",
        ),
        ([lease("plan")], False, "no wire to the autopilot"),
        (
            [
                LinkStatus(t_ns=0, link="mavlink", state="searching", reason="cannot open it"),
                LinkStatus(t_ns=0, link="uwb", state="online", reason=""),
                Tick(t_ns=0, index=1),
            ],
            False,
            "no wire to the autopilot: cannot open it",
        ),
    ],
)
def test_the_status_says_the_mode_in_words(messages, sent, text):
    heard = ServiceState()
    for message in messages:
        heard = next_state(heard, message)
    assert status_text(heard, sent=sent) == text


# --- over the socket -------------------------------------------------------------------------------


def test_lines_arrive_as_the_protocol_has_them(manager, notifier):
    notify = notifier(manager.environ)
    assert notify.send(["READY=1", "STATUS=two\nlines ü"]) and notify.send([])
    assert manager.socket.recv(1000).decode() == "READY=1\nSTATUS=two lines ü"
    assert manager.lines() == [], "nothing to say is no datagram"


def test_what_a_full_queue_refused_is_said_again(manager, notifier):
    service, sent = Service(notifier({**manager.environ, "WATCHDOG_USEC": "4000000"})), 0
    filler = notifier(manager.environ)
    while filler.send(["X_FILLER=1"]):
        sent += 1
        assert sent < 100_000
    service.see(timing(1.0))
    assert set(manager.lines()) == {"X_FILLER=1"}
    service.see(timing(1.1))
    assert manager.lines() == ["READY=1", "WATCHDOG=1", "STATUS=neutral"]
    service.see(timing(1.2))
    assert manager.lines() == []
    service.see(timing(2.1))
    assert manager.lines() == ["WATCHDOG=1"]


def test_the_end_is_said_once_and_nothing_after_it(manager):
    with Service(SdNotify(manager.environ, PID)) as service:
        service.starting("building")
        service.see(timing(1.0))
        service.stopping()
        service.see(timing(2.0))
    lines = manager.lines()
    assert lines[:2] == ["STATUS=starting: building", "EXTEND_TIMEOUT_USEC=60000000"]
    assert [line for line in lines if "=1" in line] == ["READY=1", "STOPPING=1"]


@pytest.mark.parametrize("name", ["", "relative", "vsock:2:1234", "/nobody/listens/here", "@nobody-listens-here"])
def test_without_a_listener_nothing_happens(name, notifier):
    service = Service(notifier({"NOTIFY_SOCKET": name} if name else {}))
    service.starting("x")
    service.see(timing(1.0))
    service.stopping()


@pytest.mark.parametrize(
    ("environ", "watchdog_ns"),
    [
        ({}, None),
        ({"WATCHDOG_USEC": "3000000"}, 3 * S),
        ({"WATCHDOG_USEC": "3000000", "WATCHDOG_PID": str(PID)}, 3 * S),
        ({"WATCHDOG_USEC": "3000000", "WATCHDOG_PID": str(PID + 1)}, None),
        ({"WATCHDOG_USEC": "0"}, None),
        ({"WATCHDOG_USEC": "-5"}, None),
        ({"WATCHDOG_USEC": "soon"}, None),
        ({"WATCHDOG_USEC": "²"}, None),
    ],
)
def test_the_watchdog_is_ours_or_none(environ, watchdog_ns, notifier):
    assert notifier({"NOTIFY_SOCKET": "/x", **environ}).watchdog_ns == watchdog_ns
    assert notifier(environ).watchdog_ns is None


def test_a_path_that_is_too_long_is_not_ours_to_raise(tmp_path, notifier):
    assert notifier({"NOTIFY_SOCKET": str(tmp_path / ("x" * 200))}).send(["READY=1"]) is False
