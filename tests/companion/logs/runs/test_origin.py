"""Logs of one water with origins of their own: the same places on earth, and one origin for all."""

import numpy as np
from msgspec.structs import replace

from companion.core.geometry.frames import Origin, geodetic_from_site, site_from_geodetic
from companion.logs.runs.fingerprint import fingerprint, overlap
from companion.logs.runs.origin import ORIGINS, origin_words, stated_origin, with_one_origin
from companion.logs.runs.run import Run
from tests.companion.logs.runs.test_fingerprint import at, square

HERE = Origin(63.4, 10.4)


def from_first_fix(first: int = 0, last: int | None = None, seed: int = 1, name: str = "a") -> Run:
    """A part of a drive as a receiver has it, in digits of 1e-7 degrees, with its first fix as its origin."""
    fixes = [
        tuple(round(angle, 7) for angle in geodetic_from_site(HERE, *p)) for p in square(seed)[first:last].tolist()
    ]
    origin = Origin(*fixes[0])
    run = at(np.array([site_from_geodetic(origin, *fix) for fix in fixes]), 1e-9)
    words = dict.fromkeys(("north_m", "east_m"), f"GPS antenna, {origin_words(origin)}")
    return Run(run.table, replace(run.meta, source=name, columns=words))


def test_what_a_run_states_of_its_origin_is_read_back():
    origin = Origin(-63.4000001, 179.9999999)
    run = from_first_fix()
    told = Run(run.table, replace(run.meta, columns={"north_m": f"GPS antenna, {origin_words(origin)}"}))
    assert stated_origin(told) == origin
    assert stated_origin(at(square(1), 0.01)) is None


def test_a_cut_of_a_log_is_found_though_it_has_an_origin_of_its_own():
    whole, cut, other = from_first_fix(), from_first_fix(1000, 1300), from_first_fix(seed=2)
    assert not np.allclose(whole.samples("north_m")[1][1000], cut.samples("north_m")[1][0])
    assert overlap(fingerprint(whole), fingerprint(cut))
    assert not overlap(fingerprint(whole), fingerprint(other))


def test_logs_of_one_invocation_have_one_origin():
    whole, cut = from_first_fix(), from_first_fix(1000, 1300, name="b")
    one, moved = with_one_origin([whole, cut])
    assert one is whole
    np.testing.assert_allclose(
        moved.samples("north_m", "east_m")[1], whole.samples("north_m", "east_m")[1][1000:1300], atol=1e-6
    )
    assert stated_origin(moved) == stated_origin(whole) and overlap(fingerprint(moved), fingerprint(whole))
    (note,) = moved.meta.notes
    assert note.kind == ORIGINS and note.text.startswith("its positions are from the origin of a, ")
    assert with_one_origin([cut])[0] is cut


def test_an_origin_that_is_another_waters_or_a_sites_is_said():
    run, plain = from_first_fix(), at(square(1), 0.01)
    far = Run(run.table, replace(run.meta, columns={"north_m": origin_words(Origin(60.0, 10.0))}))
    site = Run(plain.table, replace(plain.meta, site="basin"))
    for other in (far, site):
        kept, said = with_one_origin([run, other])
        assert kept is run and said.table.equals(other.table)
        assert "what depends on the place means nothing across them" in said.meta.notes[-1].text
    assert with_one_origin([plain, plain])[0].meta.notes == (), "nothing is known of either"
