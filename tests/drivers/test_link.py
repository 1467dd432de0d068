"""A device link from searching to online, stale, lost and back, on a stepped clock and on a real pty."""

import random

import pytest

from drivers.dvl import DvlCodec
from drivers.link import LinkTiming
from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.signing import Signing, SigningKey
from drivers.uwb import uwb_codec
from drivers.uwb.dwm1001 import TagFix, encode_lep
from drivers.uwb.mauwb import encode_at
from tests.drivers.link_bench import Bench, live
from tests.drivers.mavlink.mavlink_autopilot import Sender


def test_a_life_from_searching_to_online_stale_lost_and_back():
    async def story(bench: Bench) -> None:
        assert bench.link.state == "searching"
        await bench.seconds(0.5)
        for index in range(20):
            bench.device.send(f"$ {index}\n".encode())
            await bench.seconds(0.1)
        await bench.seconds(6.0)
        await bench.revive()
        await bench.seconds(0.5)
        bench.device.send(b"$ back\n")
        await bench.seconds(0.1)

    bench = live(story)
    assert bench.states() == ["searching", "online", "stale", "lost", "searching", "online"]
    assert [text for _, text in bench.texts] == [f"$ {index}" for index in range(20)] + ["$ back"]
    assert bench.raw == b"".join(f"$ {index}\n".encode() for index in range(20)) + b"$ back\n"
    last_s = 0.5 + 19 * 0.1
    when = {state: (t_s, reason) for t_s, state, reason in reversed(bench.told)}
    assert when["online"] == (pytest.approx(0.5), "messages arrive")
    assert when["stale"] == (pytest.approx(last_s + 1.2), "no bytes for 1.2 s")
    assert when["lost"] == (pytest.approx(last_s + 4.0), "no bytes for 4.0 s")
    again_s = next(t_s for t_s, state, _ in bench.told if state == "searching" and t_s > last_s)
    assert last_s + 4.1 <= again_s <= last_s + 4.125, "lost is told until the port opens again"


def test_a_pause_shorter_than_stale_is_not_told():
    async def story(bench: Bench) -> None:
        for _ in range(5):
            bench.device.send(b"$\n")
            await bench.seconds(1.19)

    bench = live(story)
    assert bench.states() == ["searching", "online"]
    assert sum(state == "online" for _, state, _ in bench.told) == 1


def test_an_hour_of_a_device_that_is_not_there_and_then_comes():
    async def story(bench: Bench) -> None:
        await bench.port.other.close()
        bench.port.plugged = False
        await bench.device.close()
        await bench.seconds(3600)
        assert 3600 / 2.0 * 0.9 < bench.port.opened < 3600 / 1.5 * 1.1 + 10
        bench.port.plugged = True
        await bench.device.open()
        await bench.seconds(2.0)
        bench.device.send(b"$ here\n")
        await bench.seconds(0)

    bench = live(story)
    reasons = [reason for _, _, reason in bench.told]
    assert "cannot open imu: No such file or directory" in reasons
    assert len(bench.told) < 10, "an hour of the same reason is one piece of news"
    assert bench.told[-1][1] == "online"


def test_garbage_never_counts_as_online_and_says_why():
    rng = random.Random(6)

    async def story(bench: Bench) -> None:
        for _ in range(35):
            bench.device.send(rng.randbytes(30).replace(b"$", b"#"))
            await bench.seconds(0.1)

    bench = live(story)
    assert bench.told[-1] == (pytest.approx(3.0), "searching", "bytes but no valid frame for 3.0 s: wrong baud rate?")
    assert bench.states() == ["searching"]
    assert not bench.texts


def test_sound_frames_that_tell_nothing_are_no_wrong_baud_rate():
    """A tag without an anchor in sight; a ground station where the autopilot should be."""

    async def story(bench: Bench) -> None:
        for line in (b"$ 1.00 m\n", *[b"%\n", b"noise\n"] * 18):
            bench.device.send(line)
            await bench.seconds(0.1)

    bench = live(story)
    why = "it speaks, but has told nothing for 3.0 s: nothing in its sight, or not our device?"
    assert (pytest.approx(3.1), "stale", why) in bench.told
    assert not [reason for _, _, reason in bench.told if "baud" in reason]


@pytest.mark.parametrize(
    ("codec", "sound"),
    [
        (uwb_codec("mauwb", "t", 1.0), encode_at(0, 1, {})),
        (uwb_codec("dwm1001-lep", "t", 1.0), encode_lep(TagFix((0.0, 0.0, 0.0), 0))),
        (DvlCodec(), b'{"type":"position_local","x":0.1}\r\n'),
        (MavlinkCodec(), Sender(255, 190).beat(kind=6, autopilot=8)),
        (MavlinkCodec(signing=Signing(SigningKey(b"k" * 32), lambda: 0, key_name="boat.key")), Sender().beat()),
    ],
)
def test_a_codec_knows_sound_frames_that_tell_nothing_from_noise(codec, sound):
    assert (codec.feed(sound, 0), codec.understood) == ([], 1)
    assert (codec.feed(b"\x00\x80\xfd\n", 1), codec.understood) == ([], 1)


def test_what_a_device_says_as_it_is_spoken_to_is_no_wrong_baud_rate():
    """A DWM1001 at 1 Hz: listened to for 1.2 s, then its shell answers, and the first ranges come 2.4 s after that."""

    async def story(bench: Bench) -> None:
        await bench.seconds(1.3)
        for answer in (b"DWM1001 TWR Real Time Location System\n", b"dwm> lec\n", b"dwm> \n"):
            bench.device.send(answer)
            await bench.seconds(0.8)
        for _ in range(3):
            bench.device.send(b"$ 1.00 m\n")
            await bench.seconds(1.0)

    bench = live(story, LinkTiming(stale_after_s=2.5, lost_after_s=20.0))
    assert not [reason for _, _, reason in bench.told if "baud" in reason]
    assert bench.states() == ["searching", "online"]


def test_garbage_that_begins_late_is_told_once_it_has_lasted():
    async def story(bench: Bench) -> None:
        await bench.seconds(4.0)
        for _ in range(80):
            bench.device.send(b"garbage\n")
            await bench.seconds(0.1)

    bench = live(story, LinkTiming(stale_after_s=2.5, lost_after_s=20.0))
    (when_s,) = [t_s for t_s, _, reason in bench.told if "wrong baud rate?" in reason]
    assert when_s == pytest.approx(7.0)


def test_lasting_garbage_reopens_the_port_so_that_a_udp_lock_is_given_up():
    async def story(bench: Bench) -> None:
        for opened in (1, 2, 3):
            assert bench.port.opened == opened
            for _ in range(40):
                bench.device.send(b"garbage\n")
                await bench.seconds(0.1)
            while not bench.device.has_ended:
                bench.device.send(b"garbage\n")
                await bench.seconds(0.1)
            await bench.revive()
            await bench.seconds(0.6)

    bench = live(story)
    assert bench.states() == ["searching"]


def test_a_device_that_starts_after_a_minute_of_silence_is_not_reopened_for_its_boot_text():
    async def story(bench: Bench) -> None:
        bench.device.send(b"boot\n")
        await bench.seconds(60.0)
        for _ in range(30):
            bench.device.send(b"ESP-ROM:esp32\n")
            await bench.seconds(0.1)
        bench.device.send(b"$ 1.00 m\n")
        await bench.seconds(0)
        assert bench.port.opened == 1

    assert live(story).states() == ["searching", "online"]
