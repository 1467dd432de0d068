"""What stands in the tables of scores."""

from types import SimpleNamespace

import pytest

from sim.fitting.validate.table import percent, stability_rows


def test_one_run_of_many_that_diverges_is_not_told_as_none():
    scores = [SimpleNamespace(diverged=[0.0, 1 / 250]), SimpleNamespace(diverged=[0.0, 0.0])]
    stable = [
        SimpleNamespace(driven_diverged=rest, free_diverged=0.0, free_at_rest=1 - rest) for rest in (1 / 250, 0.0)
    ]
    rows = stability_rows(SimpleNamespace(scores=scores, stabilities=stable))  # pyright: ignore[reportArgumentType]
    assert [row[1:] for row in rows] == [
        ("under 1 %", "0 %"), ("under 1 %", "0 %"), ("0 %", "0 %"), ("over 99 %", "100 %"),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("share", "said"), [(0.005, "under 1 %"), (0.006, "1 %"), (0.994, "99 %"), (0.995, "over 99 %")]
)
def test_only_none_and_all_are_rounded_to_them(share, said):
    assert percent(share) == said
