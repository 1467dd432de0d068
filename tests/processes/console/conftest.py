"""A browser, and a console with the key of every boat."""

import pytest

from tests.support.console_fixture import KEY, TapedBoat, chromium, served
from tests.support.zenoh_fixture import free_port


@pytest.fixture(scope="module")
def browser():
    with chromium() as made:
        yield made


@pytest.fixture
def zenoh_port():
    """Where boats find the console."""
    return free_port()


@pytest.fixture
def boat(zenoh_port):
    """A boat that keeps what it was told."""
    made = TapedBoat(zenoh_port, "one")
    yield made
    made.close()


@pytest.fixture
def console(tmp_path, zenoh_port):
    """`aritra shore` with a key; its address."""
    (tmp_path / "boat.key").write_bytes(KEY)
    (tmp_path / "boat.key").chmod(0o600)
    listen = f"tcp/127.0.0.1:{zenoh_port}"
    with served(tmp_path / "shore.txt", "--listen", listen, "--command-key", tmp_path / "boat.key") as (address, _):
        yield address
