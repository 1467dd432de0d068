"""Machine code between runs: kept, found again, never trusted when damaged, never in the way."""

import os
from pathlib import Path

import pytest

from companion.jit.cache import MOST_FILES, CodeStore, cache_folder


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
