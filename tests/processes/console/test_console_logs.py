"""The list of logs in the page: downloaded, and opened in a tab that may order nothing."""

import pytest

from tests.companion.logs.page.page_logs import page_log
from tests.processes.console.layout import SIZES, THEMES, overlaps, resize
from tests.processes.console.test_console_theme import grave
from tests.support.console_fixture import Page, served

pytestmark = [pytest.mark.real_time, pytest.mark.long]


@pytest.fixture
def desk(tmp_path, zenoh_port):
    """A console with a folder of one log and its continuation; address and folder."""
    folder = tmp_path / "logs"
    folder.mkdir()
    page_log(folder)
    (folder / "other.part1.mcap").write_bytes(b"x" * 1_500_000)
    given = ("--listen", f"tcp/127.0.0.1:{zenoh_port}", "--logs", folder)
    with served(tmp_path / "shore.txt", *given) as (address, _):
        yield address, folder


def test_logs_are_listed_downloaded_and_opened(desk, browser, tmp_path):
    address, folder = desk
    page = Page(browser, address)
    page.wait("document.querySelectorAll('#logs tbody tr').length === 2")
    assert page.page.locator("#logs a").count() == 3, "a continuation opens with its first file"
    assert "1.5\u202fMB" in page.text("#logs")
    with page.page.expect_download() as saved:
        page.page.click("[aria-label='Download boat.mcap']")
    saved.value.save_as(tmp_path / "copy.mcap")
    assert (tmp_path / "copy.mcap").read_bytes() == (folder / "boat.mcap").read_bytes()
    with page.context.expect_page() as opened:
        page.page.click("[aria-label='Open boat.mcap']")
    log = opened.value
    errors = []
    log.on("pageerror", lambda error: errors.append(str(error)))
    log.locator("#plots canvas").first.wait_for()
    assert log.evaluate("self.origin") == "null", "of its own origin: it may give no orders"
    refused = log.evaluate("fetch('/stop', { method: 'POST' }).then(() => 'sent', () => 'blocked')")
    assert refused == "blocked" and errors == []
    (folder / "new.mcap").write_bytes(b"")
    page.page.click("#log-again")
    page.wait("document.querySelectorAll('#logs tbody tr').length === 3")
    for width in SIZES:
        for theme in THEMES:
            resize(page, width, theme)
            assert overlaps(page) == [] and page.page.evaluate("document.documentElement.scrollWidth") <= width
            assert grave(page) == [] and grave(page, ["color-contrast-enhanced"]) == []
    assert page.unexpected() == []
    page.context.close()
