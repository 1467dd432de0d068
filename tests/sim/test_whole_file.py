"""A file that is there whole or not at all, on a full disk as well."""

import errno
import os

import pytest

from sim.whole_file import write_all_or_none, write_whole


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


@pytest.mark.parametrize("end", [OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), KeyboardInterrupt()])
def test_results_are_there_as_a_whole_or_not_at_all(tmp_path, monkeypatch, end):
    """Half a vessel.toml stayed on a full disk, without the name of a file, and kept the next attempt out."""
    files, synced = {"vessel.toml": b"a = 1", "report.html": b"<p>"}, []

    def ends(descriptor):
        synced.append(descriptor)
        if len(synced) == len(files):
            raise end

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", ends)
        with pytest.raises(type(end)) as told:
            write_all_or_none(tmp_path, files)
    assert not list(tmp_path.iterdir())
    assert not isinstance(told.value, OSError) or told.value.filename == str(tmp_path / "report.html")
    write_all_or_none(tmp_path, files)
    with pytest.raises(FileExistsError, match="exists by now"):
        write_all_or_none(tmp_path, files)
