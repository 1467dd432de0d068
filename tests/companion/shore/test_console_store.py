"""The console's pure parts: what it keeps of boats, what browsers are due, and whom it believes."""

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.core.telemetry import structs as shore
from companion.shore.console.fan_out import QUEUE, QUIET_MS, Watcher
from companion.shore.console.request_auth import RequestAuth, is_loopback
from companion.shore.console.store import BOATS, KEPT, MAX_BYTES, OLDER, RUNS, SILENT_NS, BoatStore
from tests.support.console_fixture import S, alert, mode, state


def put(store, *told, boat="b", heard_ns=None):
    """Samples into the store, heard 1 ms after they were told."""
    taken = []
    for each in told:
        at = each.t_ns + S // 1000 if heard_ns is None else heard_ns
        taken.append(store.take(boat, shore.topic_of(each), shore.encode(each), at))
    return taken


# --- store ------------------------------------------------------------------------------------------


def test_memory_is_bounded_by_topic_and_the_newest_counts():
    store = BoatStore()
    for k in range(3 * KEPT["state"]):
        put(store, state(k))
    boat = store.boats["b"]
    assert len(boat.kept["state"]) == KEPT["state"]
    assert json.loads(boat.newest("state").data)["north_m"] == 3 * KEPT["state"] - 1
    put(store, state(5))  # what was missed comes late
    assert json.loads(boat.newest("state").data)["north_m"] == 3 * KEPT["state"] - 1
    assert boat.newest("battery") is None


def test_a_new_run_is_shown_once_the_old_is_silent_and_nothing_of_it_is_lost():
    store = BoatStore()
    put(store, state(0), alert(1, "old"), heard_ns=10 * S)
    assert put(store, state(0, run="run2"), alert(2, "new", run="run2"), heard_ns=12 * S) == [None, None]
    boat = store.boats["b"]
    assert boat.run == "run1" and store.refused["of another run"] == 2, "the old one may still speak"
    put(store, state(1, run="run2"), heard_ns=12 * S + SILENT_NS)
    assert boat.run == "run2" and [json.loads(s.data)["text"] for s in boat.kept["alert"]] == ["new"]
    assert len(boat.kept["state"]) == 2 and boat.newest_ns == 10 * S + 2 * S // 10
    for k in range(RUNS + 2):
        put(store, state(0, run=f"later{k}"), heard_ns=(30 + 4 * k) * S)
    assert boat.run == f"later{RUNS + 1}"


def test_a_run_that_was_away_comes_back():
    """It was left out for good, and stops were made out for one that had gone."""
    store = BoatStore()
    put(store, state(0), heard_ns=0)
    put(store, state(0, run="guest"), heard_ns=10 * S)
    boat = store.boats["b"]
    assert boat.run == "guest"
    put(store, state(1), heard_ns=11 * S)
    assert boat.run == "guest"
    assert put(store, state(2), heard_ns=14 * S) != [None] and boat.run == "run1"


def test_one_sample_of_another_run_takes_nothing_away():
    store = BoatStore()
    for k in range(100):
        put(store, state(k), heard_ns=k * S // 10)
        if k == 50:
            put(store, state(0, run="forged", t_ns=10**15), heard_ns=k * S // 10)
    boat = store.boats["b"]
    assert boat.run == "run1" and len(boat.kept["state"]) == 100 and boat.runs(99 * S // 10) == ("run1",)


def test_programs_of_one_name_are_noticed_what_only_came_late_is_not():
    store = BoatStore()
    put(store, state(0), heard_ns=0)
    put(store, state(0, run="run2"), heard_ns=S)
    boat = store.boats["b"]
    put(store, state(1), heard_ns=2 * S)
    assert boat.runs(2 * S) == ("run1",), "a second late"
    put(store, state(1, run="run2"), state(2), heard_ns=4 * S)
    assert boat.runs(5 * S) == ("run1", "run2") and boat.place(5 * S) is None, "of which of them is not known"
    put(store, state(9), heard_ns=8 * S)
    assert boat.runs(8 * S) == ("run1",) and boat.place(8 * S).run == "run1"
    assert boat.runs(20 * S) == () and boat.place(20 * S).run == "run1", "silent, and to be stopped as it was"


def test_a_clock_that_was_made_up_is_forgotten():
    store = BoatStore()
    put(store, state(0, t_ns=100 * S), heard_ns=0)
    put(store, state(0, t_ns=3700 * S), heard_ns=S // 2)
    for k in range(1, 120):
        put(store, state(k, t_ns=100 * S + k * S // 10), heard_ns=k * S // 10)
    boat = store.boats["b"]
    assert boat.ahead_ns == 100 * S and boat.place(12 * S).t_ns == 112 * S


def test_rubbish_is_counted_and_left_out():
    store = BoatStore()
    good = shore.encode(state(1))
    named = [("state", shore.encode(state(1, run=run))) for run in ("\x1b[2J", "x" * 65)]
    bad = [("state", b"{}"), ("state", b"\xff"), ("nonsense", good), ("state", good[:-1]), ("state", b""), *named]
    for topic, data in bad:
        assert store.take("b", topic, data, 0) is None
    assert store.refused == {"not understood": 7} and not store.boats
    assert store.take("b", "state", b" " * (MAX_BYTES + 1), 0) is None
    assert store.take("a/b", "state", good, 0) is None and store.take("__proto__ ", "state", good, 0) is None
    assert store.refused["a strange name"] == 2
    for k in range(BOATS + 5):
        store.take(f"b{k}", "state", good, k)
        store.take("b0", "state", good, k)
    assert len(store.boats) == BOATS and "b0" in store.boats and "b1" not in store.boats, "the longest silent went"


def test_what_goes_on_to_browsers_was_written_anew():
    """Unknown fields and white space of a stranger do not reach the page."""
    store = BoatStore()
    (sample,) = [store.take("b", "alert", shore.encode(alert(1, "x"))[:-1] + b', "extra": "</script>" }', 0)]
    assert sample and b"extra" not in sample.data and json.loads(sample.data)["text"] == "x"


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=200), st.sampled_from([*shore.TOPICS, "?"]))
def test_no_bytes_raise(data, topic):
    assert BoatStore().take("b", topic, data, 0) is None


@given(st.lists(st.floats(0.0, 0.3), min_size=1, max_size=40), st.integers(-(10**15), 10**15))
def test_the_boats_clock_is_known_as_well_as_its_quickest_sample(delays_s, apart_ns):
    """Whatever the clocks show and however samples are held up: an age is never below the truth by more than drift."""
    store, start_ns = BoatStore(), 10**15
    for k, delay_s in enumerate(delays_s):
        t_ns = start_ns + k * S // 10
        put(store, state(0, t_ns=t_ns + 10**15), heard_ns=t_ns + apart_ns + round(delay_s * S))
    ahead_ns = store.boats["b"].ahead_ns
    best_s = (10**15 - apart_ns - ahead_ns) * 1e-9
    assert min(delays_s) - 1e-6 <= best_s <= delays_s[-1] + 1e-6
    assert best_s <= min(delays_s) + 1e-3 * 0.1 * len(delays_s) * 2 + 1e-3


# --- fan-out ----------------------------------------------------------------------------------------


def frame(watcher, store, now_ms=0.0):
    made = watcher.frame(store.boats, now_ms)
    return made and json.loads(made)


def entries(told, boat=None):
    return [(e["topic"], e["sample"].get("north_m")) for e in told["samples"] if boat in (None, e["boat"])]


def test_the_chosen_boat_comes_whole_the_others_as_newest_places():
    store, watcher = BoatStore(), Watcher()
    watcher.choose(store.boats, "a")
    for k in range(3):
        for boat in ("a", "b"):
            for sample in put(store, state(k), mode(k), boat=boat):
                watcher.note(sample)
    for sample in put(store, alert(1, "one"), alert(2, "two"), boat="b"):
        watcher.note(sample)
    told = frame(watcher, store)
    assert [n for topic, n in entries(told, "a") if topic == "state"] == [0, 1, 2]
    assert [n for topic, n in entries(told, "b") if topic == "state"] == [2]
    assert [topic for topic, _ in entries(told, "b")].count("alert") == 2, "no alert of any boat is left out"
    assert set(told["clocks"]) == {"a", "b"}
    assert frame(watcher, store, 100.0) is None, "nothing new, nothing sent"
    quiet = frame(watcher, store, QUIET_MS + 1)
    assert quiet["samples"] == [] and quiet["now_ms"] == QUIET_MS + 1, "a sign of life"
    store.alive("c", True)
    assert frame(watcher, store)["clocks"] == {"c": [None, True, 0, ""]}, "its token alone: no clock is known"


def test_choosing_brings_what_was_kept():
    store, watcher = BoatStore(), Watcher()
    put(store, *(state(k) for k in range(50)), mode(3), alert(1, "x"))
    watcher.begin(store.boats.values())
    assert [n for topic, n in entries(frame(watcher, store)) if topic == "state"] == [49]
    watcher.choose(store.boats, "b")
    assert [n for topic, n in entries(frame(watcher, store)) if topic == "state"] == list(range(50))
    watcher.choose(store.boats, "nobody")


def test_when_another_run_is_shown_browsers_get_it_whole():
    store, watchers = BoatStore(), [Watcher(), Watcher()]
    watchers[0].choose(store.boats, "b")
    for sample in put(store, state(5), alert(1, "old"), heard_ns=0):
        for watcher in watchers:
            watcher.note(sample)
    put(store, *(state(k, run="run2", t_ns=k) for k in range(1, 4)), heard_ns=2 * S)
    put(store, state(4, run="run2", t_ns=4), heard_ns=4 * S)
    told = []
    for watcher in watchers:
        watcher.turn(store.boats["b"])
        told.append([(e["sample"]["run"], e["sample"].get("north_m")) for e in frame(watcher, store)["samples"]])
    assert told == [[("run2", float(k)) for k in range(1, 5)], [("run2", 4.0)]]


def test_a_slow_browser_misses_the_oldest_and_is_told():
    store, watcher = BoatStore(), Watcher()
    watcher.choose(store.boats, "b")
    for k in range(QUEUE + 10):
        watcher.note(put(store, state(k))[0])
    told = frame(watcher, store)
    assert told["missed"] == 10 and len(told["samples"]) == QUEUE
    assert told["samples"][-1]["sample"]["north_m"] == QUEUE + 9


def test_frames_of_fifty_boats_are_small():
    store, watcher = BoatStore(), Watcher()
    watcher.choose(store.boats, "b0")
    for b in range(50):
        for sample in put(store, *(state(k) for k in range(10)), mode(1), boat=f"b{b}"):
            watcher.note(sample)
    made = watcher.frame(store.boats, 0.0)
    assert len(json.loads(made)["samples"]) == 11 + 49 * 2 and len(made) < 60_000


# --- guard ------------------------------------------------------------------------------------------

GUARD = RequestAuth(frozenset({"localhost", "laptop"}), "sesame-12")


@pytest.mark.parametrize(
    ("host", "good"),
    [
        ("127.0.0.1:8470", True), ("localhost:8470", True), ("LAPTOP:80", True), ("[::1]:8470", True),
        ("192.168.1.9:8470", True), ("evil.example", False), ("127.0.0.1.evil.example", False), ("", False),
        ("[::1].evil.example", False), ("localhost.evil.example:8470", False), (None, False), ("[", False),
    ],
)  # fmt: skip
def test_hosts(host, good):
    assert GUARD.host(host) == good


@pytest.mark.parametrize(
    ("origin", "needed", "good"),
    [
        ("http://127.0.0.1:8470", True, True), ("https://127.0.0.1:8470", True, True), (None, False, True),
        (None, True, False), ("null", True, False), ("http://evil.example", False, False),
        ("http://127.0.0.1:9999", True, False), ("http://127.0.0.1:8470.evil.example", True, False),
    ],
)  # fmt: skip
def test_origins(origin, needed, good):
    assert GUARD.origin(origin, "127.0.0.1:8470", needed=needed) == good


def test_tokens():
    assert GUARD.knows("sesame-12") and not GUARD.knows("sesame-1") and not GUARD.knows(None) and not GUARD.knows("é")
    assert not GUARD.knows("\udcff"), "a byte of a cookie that is no UTF-8, as aiohttp hands it over"
    assert RequestAuth(frozenset(), None).knows(None)
    assert [is_loopback(h) for h in ("127.0.0.1", "::1", "localhost", "0.0.0.0", "192.168.1.2", "boat")] == [
        True, True, True, False, False, False
    ]  # fmt: skip


def test_the_ages_are_finite():
    store = BoatStore()
    put(store, state(0, t_ns=2**53))
    assert math.isfinite(store.boats["b"].ahead_ns)


def test_what_comes_twice_is_kept_once_and_is_no_fault():
    store = BoatStore()
    told = [alert(k, f"alert {k}") for k in (1, 3, 2)]
    assert None not in put(store, *told)
    assert put(store, *reversed(told)) == [None, None, None]
    boat = store.boats["b"]
    assert len(boat.kept["alert"]) == 3 and boat.malformed == 0 and not store.refused
    assert put(store, alert(2, "another of the same instant")) != [None]


def test_a_page_that_opens_gets_the_last_ten_minutes_and_memory_stays_bounded():
    """Two minutes were kept, and of these a page got the newest 2,000 samples, by chance none of a state."""
    store, watcher = BoatStore(), Watcher()
    for k in range(10 * 900):
        put(store, state(k))
        if k % 2 == 0:
            put(store, mode(k))
    boat = store.boats["b"]
    assert len(list(boat.samples())) == KEPT["state"] + OLDER + KEPT["mode"]
    watcher.begin(store.boats.values())
    watcher.choose(store.boats, "b")
    told = frame(watcher, store)
    places = [n for topic, n in entries(told) if topic == "state"]
    whole, thinned = places[-KEPT["state"] :], places[1 : -KEPT["state"]]
    assert told["missed"] == 0 and whole == [float(n) for n in range(9000 - KEPT["state"], 9000)]
    assert len(thinned) == OLDER and set(np.diff(thinned)) == {10.0} and thinned[0] <= 9000 - 5900
    assert frame(watcher, store) is None, "once"
