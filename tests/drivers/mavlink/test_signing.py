"""MAVLink 2 signing held against pymavlink's own, and what it must not do: believe, go back, or show the key."""

import copy
import itertools
import pickle
import traceback

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as wire

from companion.core.messages import Heartbeat
from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.session import MavlinkSession
from drivers.mavlink.signing import EPOCH_NS, Signing, SigningKey
from tests.drivers.mavlink.mavlink_autopilot import Sender

SECRET = bytes(range(7, 39))
OTHER = bytes(range(90, 122))
S = 1_000_000_000
NOW_NS = EPOCH_NS + 12 * 365 * 86400 * S
NOW = (NOW_NS - EPOCH_NS) // 10_000
"""The same in units of a signature's time stamp."""


def signing(secret=SECRET, wall_ns=lambda: NOW_NS, **kwargs):
    return Signing(SigningKey(secret), wall_ns, key_name="boat.key", **kwargs)


def codec(**kwargs):
    return MavlinkCodec(signing=signing(**kwargs))


def sender(secret=SECRET, timestamp=NOW, link_id=0, **kwargs):
    """An autopilot that signs as pymavlink does."""
    made = Sender(**kwargs)
    s = made.mav.signing
    s.secret_key, s.sign_outgoing, s.timestamp, s.link_id = secret, True, timestamp, link_id
    return made


def listener(secret=SECRET):
    """A receiver that checks as pymavlink does."""
    mav = wire.MAVLink(None)
    mav.signing.secret_key, mav.robust_parsing = secret, True
    return mav


def heard(mav, data):
    return [m.get_type() for m in mav.parse_buffer(data) or [] if m.get_type() != "BAD_DATA"]


def timestamp_of(frame):
    return int.from_bytes(frame[-12:-6], "little")


def test_pymavlink_believes_what_we_sign_and_only_with_the_key():
    encoder = MavlinkCodec(1, 191, 1, signing=signing()).encoder
    frames = [encoder.heartbeat(), encoder.neutral((9, 10)), encoder.arm(), encoder.timesync(0, 5)]
    right, wrong = listener(), listener(OTHER)
    told = [name for frame in frames for name in heard(right, frame)]
    assert told == ["HEARTBEAT", "RC_CHANNELS_OVERRIDE", "COMMAND_LONG", "TIMESYNC"]
    assert right.signing.goodsig_count == 4
    assert not [name for frame in frames for name in heard(wrong, frame)] and wrong.signing.badsig_count == 4


def test_we_believe_what_pymavlink_signs_and_only_with_the_key():
    autopilot, mine, strange = sender(), codec(), codec(secret=OTHER)
    frames = [autopilot.beat(), autopilot.imu(), autopilot.att()]
    assert len([m for f in frames for m in mine.feed(f, S)]) == 3
    assert mine.signing.counts == {"believed": 3}
    assert [m for f in frames for m in strange.feed(f, S)] == []
    assert strange.signing.counts == {"wrong": 3}
    assert strange.target is None and not strange.counters.received, "as if it had never come"


@settings(max_examples=60, deadline=None)
@given(st.lists(st.integers(0, 2**61), min_size=2, max_size=20), st.integers(0, NOW))
def test_time_stamps_only_rise_whatever_the_clock_does(clock_ns, floor):
    """From 1970 to 2043: each frame's stamp is above the one before and above the floor."""
    times = iter(clock_ns)
    encoder = MavlinkCodec(1, 191, 1, signing=signing(wall_ns=lambda: next(times), floor=floor)).encoder
    stamps = [floor, *(timestamp_of(encoder.heartbeat()) for _ in clock_ns)]
    assert all(later > earlier for earlier, later in itertools.pairwise(stamps))
    assert all(stamp >= (t_ns - EPOCH_NS) // 10_000 for stamp, t_ns in zip(stamps[1:], clock_ns, strict=True))


def test_a_restart_with_the_clock_set_back_goes_on_above_what_was_sent_before():
    before = MavlinkCodec(1, 191, 1, signing=signing())
    ear = listener()
    assert heard(ear, before.encoder.heartbeat())

    def stale():
        return EPOCH_NS - 5 * S

    forgetful = MavlinkCodec(1, 191, 1, signing=signing(wall_ns=stale))
    assert not heard(ear, forgetful.encoder.heartbeat()), "what the floor is for"
    after = MavlinkCodec(1, 191, 1, signing=signing(wall_ns=stale, floor=before.signing.timestamp))
    assert heard(ear, after.encoder.heartbeat())


def test_what_the_autopilot_signs_moves_us_on_too():
    mine = codec(wall_ns=lambda: EPOCH_NS)
    mine.feed(sender(timestamp=NOW).beat(), S)
    assert timestamp_of(mine.encoder.heartbeat()) > NOW


def test_a_recording_is_not_believed_a_second_time():
    autopilot, mine = sender(), codec()
    first, second = autopilot.beat(), autopilot.beat(armed=True)
    assert mine.feed(first, S) and mine.feed(second, S)
    assert mine.feed(first + second, 2 * S) == [] and mine.signing.counts == {"believed": 2, "old": 2}


@pytest.mark.parametrize(("behind_s", "believed"), [(-3600, True), (59.9, True), (60.1, False), (86400, False)])
def test_a_new_stream_may_be_a_minute_behind(behind_s, believed):
    data = sender(timestamp=NOW - round(behind_s * 1e5)).beat()
    assert bool(codec().feed(data, S)) is believed
    oracle = listener()
    oracle.signing.timestamp = NOW
    assert bool(heard(oracle, data)) is believed, "pymavlink judges alike"


def test_one_forged_frame_from_the_future_does_not_silence_the_autopilot():
    forged, true = sender(OTHER, timestamp=2**48 - 2).beat(), sender().beat()
    mine, oracle = codec(), listener()
    assert mine.feed(forged, S) == [] and mine.feed(true, S)
    heard(oracle, forged)
    assert not heard(oracle, true), "pymavlink has learnt better: then its check would do"


def test_streams_are_told_apart():
    mine = codec()
    for who in (sender(), sender(timestamp=NOW - 100, link_id=1), sender(timestamp=NOW - 100, component=2)):
        before = mine.signing.counts["believed"]
        mine.feed(who.beat(), S)
        assert mine.signing.counts["believed"] == before + 1


def test_unsigned_frames_are_refused_but_for_the_radios_own():
    mine = codec()
    for plain in (Sender(), Sender(v1=True)):
        assert mine.feed(plain.beat(), S) == []
        mine.feed(plain.radio_status(1, 2, 3, 4, 5, 6, 7), S)
        mine.feed(plain.radio(1, 2, 3, 4, 5, 6, 7), S)
    assert mine.signing.counts == {"unsigned": 2, "welcome": 4}
    assert mine.target is None


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 12), st.integers(1, 255))
def test_no_changed_signature_block_is_believed(place, flip):
    data = bytearray(sender().beat())
    data[len(data) - 13 + place] ^= flip
    mine = codec()
    assert mine.feed(bytes(data), S) == [] and mine.signing.counts == {"wrong": 1}


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=400))
def test_any_bytes_are_survived(noise):
    mine = codec()
    mine.feed(noise, S)
    mine.feed(b"\x00" * 300, 2 * S)
    assert any(isinstance(m, Heartbeat) for m in mine.feed(sender().beat(), 3 * S))


def told(session, t_ns):
    session.step((), t_ns)
    return session.take_alerts()


@pytest.mark.parametrize(
    ("frame", "word", "begin_ns"),
    [
        (sender(OTHER).beat(), "another key than boat.key", S),
        (Sender().beat(), "take mavlink.signing_key out of the run file", S),
        (sender(timestamp=NOW - 10**9).beat(), "time stamps go back", 7 * S),
    ],
)
def test_what_is_refused_is_told_with_what_to_look_at_and_not_too_often(frame, word, begin_ns):
    """What is old is not told in the first 5 s: the autopilot may not have heard us yet."""
    mine = codec()
    session = MavlinkSession(mine)
    assert told(session, S) == []
    if begin_ns > S:
        mine.feed(frame, S)
        assert told(session, S) == []
    mine.feed(frame, begin_ns)
    (alert,) = told(session, begin_ns)
    assert alert.level == "error" and word in alert.text and alert.text.startswith("1 MAVLink frame")
    for _ in range(40):
        mine.feed(frame, begin_ns + S)
    assert told(session, begin_ns + S) == []
    (alert,) = told(session, begin_ns + 30 * S)
    assert alert.text.startswith("40 MAVLink frame") and word in alert.text
    assert told(session, begin_ns + 61 * S) == [], "nothing new"


def test_beside_messages_that_are_believed_it_is_a_warning():
    mine = codec()
    mine.feed(sender().beat() + Sender().beat(), S)
    assert [a.level for a in mine.signing.alerts(S)] == ["warning"]


def test_the_key_cannot_be_shown_or_copied():
    key = SigningKey(SECRET)
    mine = MavlinkCodec(signing=signing())
    shown = [repr(key), str(key), f"{key!r:>40}", repr(mine.signing), repr(vars(mine.signing)), repr(vars(mine))]
    for take in (pickle.dumps, copy.copy, copy.deepcopy):
        with pytest.raises(TypeError) as error:
            take(key)
        shown += traceback.format_exception(error.value)
    for wrong in (SECRET[:31], SECRET + b"!"):
        with pytest.raises(ValueError, match="32 bytes, not 3") as error:
            SigningKey(wrong)
        shown.append(str(error.value))
    assert not [text for text in shown if SECRET.hex() in text or repr(SECRET)[2:-1] in text]


def test_a_key_of_zeros_is_refused():
    with pytest.raises(ValueError, match="no signing"):
        SigningKey(bytes(32))
