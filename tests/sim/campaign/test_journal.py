"""The journal where its folder holds another file of that name, and on a full disk."""

import errno
import os

import pytest

from companion.core.configuration.tables import ConfigError
from sim.campaign.journal import NAME, Journal
from sim.campaign.runners.job import CaseOutcome
from tests.support.campaign_fixture import PROGRAM


@pytest.mark.parametrize("theirs", [b'{"mine": 1}', b"one\ntwo", b'{"format":1,"kind":"identify","program":{}'])
def test_a_file_that_is_no_journal_stays_as_it_is(theirs, tmp_path):
    (tmp_path / NAME).write_bytes(theirs)
    with pytest.raises(ConfigError, match=r"journal\.jsonl: "):
        Journal(tmp_path, "missions", PROGRAM)
    assert (tmp_path / NAME).read_bytes() == theirs


def test_a_full_disk_names_the_journal(tmp_path, monkeypatch):
    def full(file, data) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with Journal(tmp_path, "missions", PROGRAM) as journal:
        monkeypatch.setattr(os, "write", full)
        with pytest.raises(OSError, match="No space left") as failed:
            journal.add(CaseOutcome(id="a"))
    assert failed.value.filename == str(tmp_path / NAME)
