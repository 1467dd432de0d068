"""Which plots are shown, and in which units: chosen in the page, kept for the next visit."""

import pytest

from tests.support.console_fixture import Page, TapedBoat

pytestmark = pytest.mark.real_time

SHOWN = "[...document.querySelectorAll('.plot:not([hidden]) .title')].map((t) => t.innerText)"
READY = (
    "document.querySelectorAll('.plot:not([hidden]) canvas').length === {} && aritra.history.last('one', 'attitude')"
)
SPEED = "[document.querySelector('[data-key=Speed] dd').innerText, aritra.history.last('one', 'state')]"


@pytest.mark.long
def test_plots_and_units_are_chosen_and_kept_for_the_next_visit(console, zenoh_port, browser):
    boat = TapedBoat(zenoh_port, "one")
    try:
        page = Page(browser, console)
        page.wait(READY.format(8))
        first = page.page.evaluate(SHOWN)
        assert len(first) == 8 and first[0] == "Surge u [m/s]"
        page.page.click("#plot-choice summary")
        page.page.locator("#plot-choice").get_by_label("Solve time").uncheck()
        page.page.locator("#plot-choice").get_by_label("Roll and pitch").check()
        page.page.select_option("#units", "kn rad")
        for _ in range(2):
            page.wait(READY.format(8))
            shown = page.page.evaluate(SHOWN)
            assert "Roll and pitch [°]" in shown and "Solve time [ms]" not in shown and len(shown) == 8
            assert shown[0] == "Surge u [kn]" and "Yaw rate r [rad/s]" in shown
            page.page.wait_for_timeout(500)
            told, state = page.page.evaluate(SPEED)
            speed_kn = (state["u_m_s"] ** 2 + state["v_m_s"] ** 2) ** 0.5 * 3600 / 1852
            assert told.endswith("kn") and abs(float(told.split("\u202f")[0]) - speed_kn) < 0.2
            assert "rad/s" in page.text("[data-key='Yaw rate'] dd")
            page.page.reload()
        assert page.unexpected() == []
        page.context.close()
    finally:
        boat.close()
