"""The key's file, and a run with it: closed loop with the right key, neutral and told with another."""

import asyncio
import hashlib
import itertools
import os

import pytest
from mcap.reader import make_reader

from companion.boat.load_run import EXAMPLES
from companion.boat.signing_key import keep_timestamp, load_key, load_timestamp, store_timestamp
from companion.core.configuration.tables import ConfigError
from companion.core.messages import Alert, OperatorCommand, OverrideLease
from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.signing import EPOCH_NS, Signing, SigningKey
from tests.companion.boat.app_fixture import Bench, neutral
from tests.support.stand_ins.sim_clock import SimClock

SECRET = bytes(range(200, 232))
OTHER = bytes(range(60, 92))
PHRASE = "a boat in a basin"
S = 1_000_000_000
NOW_NS = EPOCH_NS + 10**9 * S // 4


def key_file(folder, content, mode=0o600):
    path = folder / "boat.key"
    path.write_bytes(content)
    path.chmod(mode)
    return path


def load(path):
    return load_key(path, where="run.toml: mavlink.signing_key")


def is_key(key, secret):
    """Whether a key makes the signature that `secret` does."""
    frame = b"any frame"
    return key.fits(frame + hashlib.sha256(secret + frame).digest()[:6])


@pytest.mark.parametrize(
    ("content", "secret"),
    [
        (SECRET, SECRET),
        (SECRET.hex().encode(), SECRET),
        (SECRET.hex().upper().encode() + b"\n", SECRET),
        (PHRASE.encode(), hashlib.sha256(PHRASE.encode()).digest()),
        (PHRASE.encode() + b"\r\n", hashlib.sha256(PHRASE.encode()).digest()),
        (b"thirty-two characters, printable", hashlib.sha256(b"thirty-two characters, printable").digest()),
        ("Schlüssel".encode(), hashlib.sha256("Schlüssel".encode()).digest()),
    ],
)
def test_a_key_in_each_form(tmp_path, content, secret):
    assert is_key(load(key_file(tmp_path, content)), secret)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "expected 32 raw bytes, 64 hexadecimal digits or a passphrase"),
        (SECRET[:31], "expected 32 raw bytes"),
        (SECRET.hex()[:63].encode(), "63 hexadecimal digits, expected 64"),
        (b"two\nlines", "a passphrase on one line"),
        (b"\x00" * 32, "means to the autopilot: no signing"),
        (b"long" * 2000, "expected 32 raw bytes"),
    ],
)
def test_what_is_no_key_is_refused_without_showing_it(tmp_path, content, reason):
    path = key_file(tmp_path, content)
    with pytest.raises(ConfigError) as error:
        load(path)
    text = str(error.value)
    assert text.startswith(f"run.toml: mavlink.signing_key: {path}: ") and reason in text
    assert error.value.__cause__ is None
    assert not content or content[:20].decode("latin-1") not in text


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o610, 0o602])
def test_a_key_that_others_may_touch_is_refused(tmp_path, mode):
    path = key_file(tmp_path, SECRET, mode)
    with pytest.raises(ConfigError, match=f"chmod 600 {path}"):
        load(path)
    path.chmod(0o400)
    assert is_key(load(path), SECRET)


def test_a_key_that_is_not_there_or_no_file_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"boat.key: No such file"):
        load(tmp_path / "boat.key")
    with pytest.raises(ConfigError, match=r"expected a file|Is a directory"):
        load(tmp_path)


def test_a_key_written_into_the_run_file_is_not_repeated(tmp_path):
    with pytest.raises(ConfigError) as error:
        load(tmp_path / SECRET.hex())
    assert "not the name of a file" in str(error.value) and SECRET.hex() not in str(error.value)


# --- the file of time stamps ----------------------------------------------------------------------------


def test_time_stamps_are_kept_and_garbage_counts_as_none(tmp_path):
    path = tmp_path / "stamp"
    assert load_timestamp(path) == 0
    store_timestamp(path, 12345)
    assert load_timestamp(path) == 12345 and os.listdir(tmp_path) == ["stamp"]
    path.write_text("half a li")
    assert load_timestamp(path) == 0


def kept(path, seconds):
    """Alerts of `seconds` of keeping, with one frame stamped in the middle; and what was stamped."""
    signing = Signing(SigningKey(SECRET), lambda: NOW_NS, key_name="k")
    told = []

    async def play():
        clock = SimClock()
        task = asyncio.create_task(keep_timestamp(path, signing, clock, told.append))
        for _ in range(seconds):
            await asyncio.sleep(0.02)  # the thread has a moment
            await clock.advance(S)
        codec = MavlinkCodec(signing=signing)
        codec.encoder.heartbeat()
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)

    asyncio.run(play())
    return told, signing.timestamp


def test_the_last_time_stamp_outlives_the_run(tmp_path):
    told, stamp = kept(tmp_path / "stamp", 3)
    assert not told and load_timestamp(tmp_path / "stamp") == stamp > 0


def test_a_disk_that_refuses_is_told_once(tmp_path):
    told, _ = kept(tmp_path / "gone" / "stamp", 25)
    assert [a.level for a in told] == ["warning"] and "No such file" in told[0].text


# --- a run ----------------------------------------------------------------------------------------------


def signed_bench(path, secret):
    """An autopilot on SERIAL1 that has SECRET; a companion that has `secret`."""
    signing = Signing(SigningKey(secret), lambda: NOW_NS, key_name="boat.key")
    bench = Bench(path, codec=MavlinkCodec(signing=signing), serial=1)
    bench.world.rover.key.set(SECRET, 1)
    return bench


def everything_in(log):
    """All that the log holds, unpacked."""
    with log.open("rb") as file:
        reader = make_reader(file)
        texts = [message.data for _, _, message in reader.iter_messages()]
        texts += [a.data for a in reader.iter_attachments()]
        texts += [str(m.metadata).encode() for m in reader.iter_metadata()]
    return b"\n".join(texts)


def test_the_loop_is_closed_with_the_key_and_the_log_does_not_hold_it(tmp_path):
    bench = signed_bench(tmp_path / "run.mcap", SECRET)

    async def story(bench):
        await bench.drive()
        await bench.run(1.0)
        assert any(not neutral(pwm) for _, pwm in bench.overrides)

    assert bench.scene(story) is None
    assert all(m.get_msgbuf()[2] & 1 for _, m in bench.sent), "everything is signed"
    stamps = [int.from_bytes(m.get_msgbuf()[-12:-6], "little") for _, m in bench.sent]
    assert all(a < b for a, b in itertools.pairwise(stamps))
    counts = bench.codec.signing.counts
    assert counts["believed"] > 100 and set(counts) == {"believed"}
    held = everything_in(tmp_path / "run.mcap")
    assert len(held) > 100_000 and SECRET not in held and SECRET.hex().encode() not in held.lower()


def test_with_another_key_the_boat_stays_neutral_and_says_why(tmp_path):
    bench = signed_bench(tmp_path / "run.mcap", OTHER)

    async def story(bench):
        bench.app.command(OperatorCommand(t_ns=bench.clock.now_ns(), command="start"))
        await bench.run(4.0)
        assert bench.mode == "starting"

    assert bench.scene(story) is None
    assert {lease.source for lease in bench.of(OverrideLease)} == {"neutral"}
    assert {pwm for _, pwm in bench.overrides if 65534 not in pwm} == {(1500,) * 4 + (65535,) * 4 + (1500,) * 4}
    assert bench.world.rover.outputs_us[:4] == (1500,) * 4 and not bench.world.rover.vehicle.modes.armed
    (alert,) = [a for a in bench.of(Alert) if "signed" in a.text]
    assert alert.level == "error" and "boat.key" in alert.text and "same key" in alert.text


def test_aritra_run_refuses_an_open_key_before_it_writes_anything(tmp_path, capsys):
    from companion.__main__ import main

    text = (EXAMPLES / "aritra.toml").read_text()
    for name in ("boats", "sites", "missions"):
        text = text.replace(f'"{name}/', f'"{EXAMPLES}/{name}/')
    config = tmp_path / "run.toml"
    config.write_text(text.replace("[mavlink]", '[mavlink]\nsigning_key = "boat.key"'))
    key_file(tmp_path, SECRET.hex().encode(), 0o644)
    assert main(["run", "--config", str(config), "--log", str(tmp_path / "x.mcap")]) == 2
    told = capsys.readouterr()
    assert f"mavlink.signing_key: {tmp_path / 'boat.key'}" in told.err and "chmod 600" in told.err
    assert SECRET.hex() not in told.err + told.out and not (tmp_path / "x.mcap").exists()


@pytest.mark.parametrize("text", ["0x{}", " {}", "{} ", '"{}"', "{}:"])
def test_hexadecimal_digits_with_something_around_them_are_no_passphrase(tmp_path, text):
    """They were hashed: another key than the autopilot's, which then hears nothing."""
    path = tmp_path / "key"
    path.write_text(text.format("a1" * 32))
    path.chmod(0o600)
    with pytest.raises(ConfigError, match="64 hexadecimal digits with more around") as told:
        load_key(path, where="run.toml: mavlink.signing_key")
    assert "a1a1" not in str(told.value)
