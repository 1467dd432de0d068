"""A fence drawn in the page: put into the site file's own text, and read by the boat's loader."""

import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.configuration.site_file import load_site
from companion.core.configuration.tables import ConfigError
from companion.shore.console.files.sites import with_fence
from tests.support.console_server_fixture import posted

ROOT = Path(__file__).resolve().parents[5]
SITES = sorted((ROOT / "deploy/sites").glob("*.toml"))
SQUARE = [(0.0, 0.0), (10.0, 0.0), (10.0, 12.5), (0.0, 12.5)]


def asked(body, **headers):
    return posted("site", body, **headers)


@pytest.mark.parametrize("file", SITES, ids=lambda f: f.stem)
@given(st.lists(st.tuples(st.floats(-500, 500), st.floats(-500, 500)), min_size=3, max_size=9))
def test_another_fence_changes_nothing_else_of_the_file(file, fence):
    text = file.read_text()
    changed = with_fence(text, fence, name=file.name)
    before, after = tomllib.loads(text), tomllib.loads(changed)
    assert after.pop("fence") == [pytest.approx(corner, abs=0.006) for corner in fence] and before.pop("fence")
    assert after == before and [x for x in text.splitlines() if x.startswith("#")] == [
        x for x in changed.splitlines() if x.startswith("#")
    ]


def test_a_site_file_is_opened_and_given_another_fence_or_all_that_is_wrong():
    text = SITES[0].read_text()
    status, told = asked({"name": "mine.toml", "text": text})
    assert status == 200 and told["text"] == text and told["fence"] == [list(c) for c in load_site(text, name="").fence]
    _, told = asked({"name": "mine.toml", "text": text, "fence": SQUARE})
    assert load_site(told["text"], name="").fence == tuple(SQUARE)
    crossed = [SQUARE[0], SQUARE[2], SQUARE[1], SQUARE[3]]
    _, told = asked({"name": "mine.toml", "text": text, "fence": crossed})
    assert told["errors"][0].startswith("mine.toml: fence: the edges that begin at corner")
    assert "mine.toml" in asked({"name": "mine.toml", "text": "fence = 1"})[1]["errors"][0]


def test_a_fence_in_a_spelling_that_cannot_be_changed_is_said_and_not_guessed():
    for text in ('"fence" = [[0, 0]]', "[other]\nfence = 3", "fence = [[0, 0]"):
        with pytest.raises(ConfigError, match="edit it by hand"):
            with_fence(text, SQUARE, name="mine.toml")


def test_who_may_ask():
    assert asked({"name": "a.toml", "text": ""}, Origin="http://evil.example")[0] == 403
