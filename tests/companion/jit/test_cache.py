"""Machine code between runs: kept, found again, never trusted when damaged, never in the way."""

import os
import pwd
import tempfile
from pathlib import Path

import pytest

from companion.jit.cache import MOST_FILES, CodeStore, cache_folder
from companion.jit.checksummed import with_checksum


def test_what_was_put_is_found_by_the_next_run(tmp_path):
    CodeStore(tmp_path / "new" / "folder").put("key", b"code")
    assert CodeStore(tmp_path / "new" / "folder").get("key") == b"code"
    assert CodeStore(tmp_path / "new" / "folder").get("other") is None
    assert (tmp_path / "new" / "folder").stat().st_mode & 0o077 == 0


@pytest.mark.parametrize("damage", [b"", b"short", b"x" * 100])
def test_damaged_code_is_not_given_out_and_is_replaced(tmp_path, damage):
    store = CodeStore(tmp_path)
    store.put("key", b"code" * 10)
    (tmp_path / "key.o").write_bytes(damage)
    assert store.get("key") is None
    store.put("key", b"code")
    assert store.get("key") == b"code"


def test_a_cut_or_a_flipped_bit_is_noticed(tmp_path):
    store = CodeStore(tmp_path)
    store.put("key", bytes(range(200)))
    whole = (tmp_path / "key.o").read_bytes()
    for broken in (whole[:-1], whole[:50] + bytes([whole[50] ^ 1]) + whole[51:]):
        (tmp_path / "key.o").write_bytes(broken)
        assert store.get("key") is None


def test_a_folder_that_cannot_be_written_is_no_error(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    store = CodeStore(blocked / "below")
    store.put("key", b"code")
    assert store.get("key") is None


def test_the_oldest_go_first(tmp_path):
    store = CodeStore(tmp_path)
    for k in range(MOST_FILES + 3):
        store.put(f"key{k}", b"code")
        os.utime(tmp_path / f"key{k}.o", (k, k))
    store.put("last", b"code")
    left = {file.name for file in tmp_path.iterdir()}
    assert len(left) == MOST_FILES and "last.o" in left and "key0.o" not in left


@pytest.mark.parametrize(
    ("environment", "folder"),
    [
        ({"ARITRA_CACHE": "/a", "CACHE_DIRECTORY": "/b", "HOME": "/h"}, "/a"),
        ({"CACHE_DIRECTORY": "/b:/c", "HOME": "/h"}, "/b"),
        ({"XDG_CACHE_HOME": "/x", "HOME": "/h"}, "/x/aritra"),
        ({"HOME": "/h"}, "/h/.cache/aritra"),
    ],
)
def test_the_environment_names_the_folder(environment, folder):
    assert cache_folder(environment) == Path(folder)


def test_without_a_home_it_is_the_users_own_and_never_a_folder_that_all_share():
    assert cache_folder({}) == Path(pwd.getpwuid(os.geteuid()).pw_dir) / ".cache" / "aritra"
    assert Path(tempfile.gettempdir()) not in (cache_folder({}) or Path("/")).parents


def test_a_user_without_a_home_keeps_nothing(monkeypatch):
    monkeypatch.setattr(os, "geteuid", lambda: 4_000_000_000)
    assert cache_folder({}) is None
    store = CodeStore.of({})
    store.put("key", b"code")
    assert store.get("key") is None


# --- code that somebody else can have put there ------------------------------------------------------


def planted(folder):
    """Code with a right checksum, as an attacker would leave it."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "key.o").write_bytes(with_checksum(b"attacker"))
    return folder / "key.o"


def belongs_to_another(path, monkeypatch):
    """As far as we know: another user's file, or we are another user."""
    if os.geteuid() == 0:
        os.chown(path, 54321, 54321)
    else:
        monkeypatch.setattr(os, "geteuid", lambda: 54321)


def refused(folder):
    """What the store says in not giving the code out."""
    said = []
    store = CodeStore(folder, tell=said.append)
    assert store.get("key") is None and store.get("key") is None
    (line,) = said
    return line


@pytest.mark.parametrize("mode", [0o777, 0o1777, 0o770, 0o702])
def test_a_folder_that_others_may_write_to_gives_no_code_and_takes_none(tmp_path, mode):
    folder = planted(tmp_path / "cache").parent
    folder.chmod(mode)
    line = refused(folder)
    assert str(folder) in line and f"mode {mode:o}" in line and "chmod go-w" in line
    CodeStore(folder).put("other", b"code")
    assert [file.name for file in folder.iterdir()] == ["key.o"]


@pytest.mark.parametrize("mode", [0o666, 0o620, 0o602])
def test_a_file_that_others_may_write_to_gives_no_code_and_is_replaced(tmp_path, mode):
    file = planted(tmp_path / "cache")
    file.chmod(mode)
    assert str(file) in refused(file.parent)
    CodeStore(file.parent).put("key", b"ours")
    assert CodeStore(file.parent).get("key") == b"ours"


def test_a_folder_of_somebody_else_gives_no_code(tmp_path, monkeypatch):
    folder = planted(tmp_path / "cache").parent
    belongs_to_another(folder, monkeypatch)
    assert "belongs to user" in refused(folder)


def test_a_file_of_somebody_else_gives_no_code(tmp_path, monkeypatch):
    file = planted(tmp_path / "cache")
    belongs_to_another(file, monkeypatch)
    assert "belongs to user" in refused(file.parent)


def test_a_link_to_somewhere_else_gives_no_code(tmp_path):
    file = planted(tmp_path / "elsewhere")
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache" / "key.o").symlink_to(file)
    assert "symbolic link" in refused(tmp_path / "cache")


def test_a_pipe_in_its_place_does_not_stop_the_boat(tmp_path):
    os.mkfifo(tmp_path / "key.o", 0o600)
    assert "neither folder nor file" in refused(tmp_path)
