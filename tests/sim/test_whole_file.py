"""A file that is there whole or not at all, on a full disk as well."""

import errno
import os

import pytest

from sim.whole_file import write_whole


def test_a_full_disk_leaves_what_was_there_and_names_the_file(tmp_path, monkeypatch):
    path = tmp_path / "results.parquet"
    write_whole(path, b"before")

    def full(file) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left") as failed:
        write_whole(path, b"after")
    assert failed.value.filename == str(path)
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("results.parquet", b"before")]
