"""Serial lines and pseudo-terminals: raw, exclusive, unplugged and plugged in again."""

import asyncio
import errno
import os
import subprocess
import termios
import threading

import pytest

from companion.python_child import python
from drivers.ports.pseudo_terminal import PtyPort
from drivers.ports.serial_line import SerialPort
from tests.drivers.ports.port_pairs import run, take


def test_serial_is_raw_exclusive_and_says_what_is_wrong(tmp_path):
    async def main():
        device = PtyPort()
        await device.open()
        port, rival = SerialPort(device.path, 115200), SerialPort(device.path, 115200)
        await port.open()
        with pytest.raises(OSError, match="another program"):
            await rival.open()
        device.send(b"\r\n\x03\x04\x11\x13\x00\xff")
        assert await take(port, 8) == b"\r\n\x03\x04\x11\x13\x00\xff"
        await port.close()
        await rival.open()
        await rival.close()
        await device.close()
        with pytest.raises(FileNotFoundError, match="No such file"):
            await SerialPort(str(tmp_path / "ttyNONE"), 115200).open()
        (tmp_path / "plain").write_bytes(b"")
        with pytest.raises(OSError):
            await SerialPort(str(tmp_path / "plain"), 115200).open()

    run(main)


def test_serial_unplugged_while_sending_is_an_end_and_plugging_in_again_works(tmp_path):
    link = str(tmp_path / "tty")

    async def main():
        device, port = PtyPort(link), SerialPort(link, 115200)
        for _ in range(2):
            await device.open()
            await port.open()
            waiting = asyncio.create_task(port.receive())
            port.send(b"z" * 4000)
            await device.close()
            assert not os.path.lexists(link)
            assert await waiting == b""
            with pytest.raises(OSError):
                for _ in range(100):
                    port.send(b"z" * 4000)
            await port.close()
            with pytest.raises(FileNotFoundError):
                await port.open()

    run(main)


def test_a_device_that_opens_after_its_opener_was_cancelled_is_closed(monkeypatch):
    class Device:
        closed = 0

        def reset_output_buffer(self) -> None:
            raise termios.error(errno.EIO, "gone")

        def close(self) -> None:
            self.closed += 1

    slow, device = threading.Event(), Device()

    def open_slowly(*_: object, **__: object) -> Device:
        assert slow.wait(5.0)
        return device

    monkeypatch.setattr("serial.Serial", open_slowly)

    async def main():
        port = SerialPort("/dev/slow", 115200)
        opening = asyncio.create_task(port.open())
        await asyncio.sleep(0.02)
        opening.cancel()
        with pytest.raises(asyncio.CancelledError):
            await opening
        slow.set()
        while not device.closed:
            await asyncio.sleep(0.001)
        with pytest.raises(OSError):
            port.send(b"not open")

    run(main)


def test_the_pty_is_raw_for_any_program():
    async def main():
        device = PtyPort()
        await device.open()
        terminal = os.open(device.path, os.O_RDWR | os.O_NOCTTY)
        os.write(terminal, b"\n\x03\x11")
        assert await take(device, 3) == b"\n\x03\x11"
        device.send(b"\r\x04")
        assert os.read(terminal, 10) == b"\r\x04"
        os.close(terminal)
        await device.close()

    run(main)


def test_pty_device_speaks_to_nobody_without_piling_up_and_keeps_its_link_honest(tmp_path):
    link = tmp_path / "tty"

    async def main():
        device = PtyPort(str(link))
        await device.open()
        for _ in range(100):
            device.send(b"old line\r\n")
        assert device.counters.dropped_bytes == 1000
        listener = SerialPort(str(link), 115200)
        await listener.open()
        device.send(b"new line\r\n")
        assert await take(listener, 10) == b"new line\r\n"
        await listener.close()
        link.unlink()
        link.write_text("somebody's file")
        await device.close()
        assert link.read_text() == "somebody's file"
        with pytest.raises(FileExistsError, match="not a symbolic link"):
            await device.open()

    run(main)


def test_a_pty_s_link_is_not_taken_from_a_port_that_is_open(tmp_path):
    (tmp_path / "same").symlink_to(tmp_path)
    link, same = tmp_path / "tty", tmp_path / "same" / "tty"

    async def main():
        device, rival = PtyPort(str(link)), PtyPort(str(same))
        await device.open()
        with pytest.raises(OSError) as refused:
            await rival.open()
        assert refused.value.errno == errno.EADDRINUSE
        await rival.close()
        assert os.readlink(link) == device.path, "neither refusal nor close touches another's link"
        beside = PtyPort(str(tmp_path / "tty-2"))
        await beside.open()
        await beside.close()
        await device.close()
        await rival.open()
        assert os.readlink(link) == rival.path
        await rival.close()

    run(main)


def test_a_pty_that_could_not_be_made_holds_nothing(tmp_path):
    link = tmp_path / "tty"
    link.write_text("somebody's file")

    async def main():
        with pytest.raises(FileExistsError):
            await PtyPort(str(link)).open()
        link.unlink()
        device = PtyPort(str(link))
        await device.open()
        await device.close()
        with pytest.raises(FileNotFoundError):
            await PtyPort(str(tmp_path / "nowhere" / "tty")).open()

    run(main)


HOLDS = """
import asyncio, sys
from drivers.ports.pseudo_terminal import PtyPort
async def main():
    port = PtyPort(sys.argv[1])
    await port.open()
    print("open", flush=True)
    await asyncio.sleep(60)
asyncio.run(main())
"""


def test_the_link_of_a_process_that_was_killed_is_free(tmp_path):
    link = tmp_path / "tty"
    with subprocess.Popen(python("-c", HOLDS, str(link)), stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout and child.stdout.readline() == "open\n"

        async def refused():
            with pytest.raises(OSError, match="in use"):
                await PtyPort(str(link)).open()

        run(refused)
        child.kill()
    assert os.path.lexists(link), "it had no time to take it away"

    async def free():
        device = PtyPort(str(link))
        await device.open()
        assert os.readlink(link) == device.path
        await device.close()

    run(free)
