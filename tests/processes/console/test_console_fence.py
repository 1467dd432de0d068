"""The fence of a site file, drawn anew on the map, checked, and saved as a file that the boat loads."""

import pytest

from companion.core.configuration.site_file import load_site
from tests.processes.console.layout import SIZES, overlaps, resize
from tests.processes.console.test_console_mission import click, drag
from tests.project.house import ROOT
from tests.support.console_fixture import Page, TapedBoat

pytestmark = pytest.mark.real_time

SITE = ROOT / "deploy/sites/basin.toml"
SAID = "document.querySelector('#fence-says').innerText.includes('{}')"


@pytest.mark.long
def test_a_fence_is_drawn_checked_and_saved(console, zenoh_port, browser, tmp_path):
    boat = TapedBoat(zenoh_port, "one")
    try:
        page = Page(browser, console)
        page.wait("aritra.map.boats.get('one')?.made.has('hull')")
        page.page.click("#draw-fence")
        click(page, 10, 10)
        assert page.page.locator(".draft-point").count() == 0, "there is no file yet"
        page.page.set_input_files("#fence-file", ROOT / "deploy/missions/square.toml")
        page.wait(SAID.format("square.toml was not opened"))
        page.page.set_input_files("#fence-file", SITE)
        page.wait(SAID.format("4 corners. It can be saved"))
        drag(page, (29.5, 29.5), (20, 20))
        click(page, 0.5, 10)
        page.wait(SAID.format("5 corners. It can be saved"))
        drag(page, (20, 20), (12, -4))
        page.wait(SAID.format("touch"))
        assert page.page.locator("#fence-save").is_disabled()
        page.page.click("#fence-undo")
        page.wait(SAID.format("It can be saved"))
        with page.page.expect_download() as download:
            page.page.click("#fence-save")
        saved = tmp_path / "basin.toml"
        download.value.save_as(saved)
        before, after = load_site(SITE.read_text(), name="before"), load_site(saved.read_text(), name="after")
        assert download.value.suggested_filename == "basin.toml" and after.anchors == before.anchors
        assert any(corner == pytest.approx((20, 20), abs=0.2) for corner in after.fence) and len(after.fence) == 5
        for width in SIZES:
            resize(page, width, "light")
            assert overlaps(page) == []
        page.page.click("#draw")
        assert page.page.locator("#fence-box").is_hidden() and page.page.locator(".draft-point").count() == 0
        assert boat.obeyed == [] and page.unexpected() == []
        page.context.close()
    finally:
        boat.close()
