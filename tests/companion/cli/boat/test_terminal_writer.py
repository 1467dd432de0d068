"""A terminal that stops taking characters keeps nobody waiting."""

import os
import pty
import termios
import threading

import pytest

from companion.cli.boat.terminal_writer import CLOSE_S, WAITING, TerminalWriter


@pytest.fixture
def terminal():
    """Both ends of a pseudo-terminal: what people see, and what is written to."""
    seen, written = pty.openpty()
    with open(written, "w", encoding="utf-8") as out:
        yield seen, out
        termios.tcflow(out.fileno(), termios.TCOON)
    os.close(seen)


def test_what_is_written_comes_in_order(terminal):
    seen, out = terminal
    writer = TerminalWriter(out)
    assert writer.isatty()
    for text in ("one ", "two\n"):
        writer.write(text)
    writer.close()
    shown = b""
    while not shown.endswith(b"\n"):  # a terminal hands on what comes as it comes
        shown += os.read(seen, 100)
    assert shown == b"one two\r\n"


def test_after_ctrl_s_nobody_waits_and_the_newest_texts_are_kept(terminal):
    seen, out = terminal
    termios.tcflow(out.fileno(), termios.TCOOFF)
    writer = TerminalWriter(out)

    def run():
        for k in range(3 * WAITING):
            writer.write(f"{k}\n")
        writer.close()

    boat = threading.Thread(target=run, daemon=True)
    boat.start()
    boat.join(CLOSE_S + 20.0)
    assert not boat.is_alive(), "it waited for the terminal"
    termios.tcflow(out.fileno(), termios.TCOON)
    text = b""
    while f"{3 * WAITING - 1}\r\n".encode() not in text:
        text += os.read(seen, 4096)
    assert f"{2 * WAITING - 2}\r\n".encode() not in text, "the older ones are left out"


def test_a_terminal_that_was_closed_is_none_of_the_boats_business():
    reader, end = os.pipe()
    os.close(reader)
    with open(end, "w", encoding="utf-8") as out:
        writer = TerminalWriter(out)
        writer.write("gone\n")
        writer.close()
        assert not writer.isatty()
        os.set_blocking(end, False)
        os.dup2(os.open(os.devnull, os.O_WRONLY), end)
