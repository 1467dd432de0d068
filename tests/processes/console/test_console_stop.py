"""STOP in the console's page: where it is, whom it reaches, and what it says before it is needed; boats that ended."""

import contextlib

import pytest

from tests.processes.console.layout import SIZES, place, reachable, resize, scroll
from tests.support.console_fixture import KEY, Page, TapedBoat, served

pytestmark = pytest.mark.real_time

MISSION = "# a mission\nnonsense = 1\n"


@contextlib.contextmanager
def console(folder, port, *boats_with_key):
    """`aritra shore` with the key for all boats, or for these alone; its address."""
    (folder / "boat.key").write_bytes(KEY)
    (folder / "boat.key").chmod(0o600)
    keys = [("--command-key", f"{boat}={folder / 'boat.key'}") for boat in boats_with_key]
    keys = keys or [("--command-key", str(folder / "boat.key"))]
    given = [word for pair in keys for word in pair]
    with served(folder / "shore.txt", "--listen", f"tcp/127.0.0.1:{port}", *given) as (address, _):
        yield address


@contextlib.contextmanager
def boats(port, *names):
    with contextlib.ExitStack() as held:
        made = []
        for name in names:
            made.append(TapedBoat(port, name))
            held.callback(made[-1].close)
        yield made


def moments(page, folder):
    """What may come and go beside STOP, brought about one after the other; yields their names."""
    yield "as it was"
    for name in ("hold", "start"):
        page.page.click(f"#{name}")
        yield f"the question of {name}"
        page.page.keyboard.press("Escape")
    (folder / "my.toml").write_text(MISSION)
    page.page.set_input_files("#file", folder / "my.toml")
    page.wait("!document.querySelector('#question').hidden")
    yield "the question of a mission"
    page.page.keyboard.press("Escape")
    for tool in ("draw", "draw-fence", "drive-here", "steer"):
        page.page.click(f"#{tool}")
        yield tool
    page.page.click("#drive-here")
    for count in (1, 2, 3):
        page.page.keyboard.press("F9")
        page.wait(f"document.querySelectorAll('#answers li[data-kind=done]').length === {count}")
        yield f"{count} answers"
    for share in (0.5, 1.0):
        scroll(page, share)
        yield f"scrolled to {share}"
    scroll(page, 0.0)


@pytest.mark.parametrize(
    "width", [390, pytest.param(820, marks=pytest.mark.long), pytest.param(1440, marks=pytest.mark.long)]
)
def test_stop_never_moves_and_is_never_out_of_reach(tmp_path, zenoh_port, browser, width):
    with console(tmp_path, zenoh_port) as address, boats(zenoh_port, "one"):
        page = Page(browser, address, width=width, height=SIZES[width])
        before = place(page, "#stop")
        page.wait("!document.querySelector('#hold').disabled")
        for moment in moments(page, tmp_path):
            assert place(page, "#stop") == before and reachable(page, "#stop"), moment
        with boats(zenoh_port, "two"):
            page.wait("document.querySelectorAll('.boat').length === 2")
            assert place(page, "#stop") == before and reachable(page, "#stop") and reachable(page, "#stop-all")
        page.page.wait_for_timeout(500)
        assert place(page, "#stop") == before and reachable(page, "#stop")
        assert page.unexpected() == []
        page.context.close()


@pytest.mark.long
def test_stop_is_in_reach_on_a_phone_that_lies_on_its_side(tmp_path, zenoh_port, browser):
    with console(tmp_path, zenoh_port) as address, boats(zenoh_port, "one", "two"):
        page = Page(browser, address, width=844, height=390)
        page.wait("document.querySelectorAll('.boat').length === 2 && !document.querySelector('#hold').disabled")
        before = place(page, "#stop")
        for moment in moments(page, tmp_path):
            assert place(page, "#stop") == before and reachable(page, "#stop"), moment
        page.context.close()


@pytest.mark.long
def test_stop_says_that_it_has_no_key_before_it_is_needed(tmp_path, zenoh_port, browser):
    with console(tmp_path, zenoh_port, "one") as address, boats(zenoh_port, "one", "two") as (one, two):
        page = Page(browser, address)
        page.wait("document.querySelectorAll('.boat').length === 2")
        page.page.click(".boat[data-boat=one]")  # it may have heard of the other first
        page.wait("!document.querySelector('#hold').disabled")
        assert page.text("#stop-whom") == "one" and page.text("#no-orders") == ""
        page.wait("document.querySelector('#stop-all').innerText === 'STOP ALL 1'")
        page.page.click(".boat[data-boat=two]")
        page.wait("document.querySelector('#stop').disabled")
        assert "no key for two" in page.text("#stop-whom") and "--command-key" in page.text("#no-orders")
        page.page.keyboard.press("F9")
        page.wait("document.querySelector('#says').textContent.includes('STOP was not sent: no key for two')")
        page.page.click("#stop-all")
        page.wait("document.querySelector('#answers li')?.dataset.kind === 'done'")
        assert (one.obeyed, two.obeyed) == (["stop"], []) and page.unexpected() == []
        page.context.close()


@pytest.mark.long
def test_a_boat_that_ended_fades_gets_no_stop_and_can_be_put_away(tmp_path, zenoh_port, browser):
    with console(tmp_path, zenoh_port) as address, boats(zenoh_port, "one", "two") as (one, two):
        page = Page(browser, address)
        page.wait("document.querySelectorAll('.boat').length === 2")
        page.page.click(".boat[data-boat=one]")  # it may have heard of the other first
        page.wait("!document.querySelector('#hold').disabled")
        page.page.click(".boat[data-boat=two]")
        page.wait("aritra.map.boats.get('two')?.made.has('hull') && aritra.history.last('two', 'mode') !== undefined")
        two.close()
        page.wait("document.querySelector('#stop').disabled")
        assert page.text("#stop-whom") == "cannot: two has ended" and page.text("#mode strong") == "Ended"
        page.wait("aritra.map.boats.get('two').made.get('hull').options.opacity < 0.5")
        assert page.text("#stop-all") == "STOP ALL 1"
        page.page.keyboard.press("F9")
        page.wait("document.querySelector('#says').textContent.includes('two has ended')")
        page.page.click("#stop-all")
        page.wait("document.querySelector('#answers li')?.dataset.kind === 'done'")
        assert (one.obeyed, two.obeyed) == (["stop"], []) and page.page.locator("#answers li").count() == 1
        page.page.click(".away:visible")
        page.wait("document.querySelector('#stop-whom').innerText === 'one'")
        page.wait("!aritra.map.boats.has('two')")  # it goes with the next frame
        assert page.page.locator(".boat").count() == 0
        with boats(zenoh_port, "two"):
            page.wait("document.querySelectorAll('.boat').length === 2")
        assert page.unexpected() == []
        page.context.close()


def test_a_boat_that_only_says_that_it_ended_is_stopped_all_the_same(tmp_path, zenoh_port, browser):
    """Telemetry is not signed: a word of somebody else must not take the STOP away from a boat that is there."""
    with console(tmp_path, zenoh_port) as address, boats(zenoh_port, "one") as (one,):
        page = Page(browser, address)
        page.wait("!document.querySelector('#hold').disabled && aritra.history.last('one', 'mode') !== undefined")
        page.page.evaluate(
            """() => { const mode = aritra.history.last('one', 'mode');
            const sample = { ...mode, t_ns: mode.t_ns + 6e10, ended: true };
            aritra.history.push({ boat: 'one', topic: 'mode', sample }); }"""
        )
        page.page.wait_for_timeout(600)
        assert page.page.evaluate("aritra.history.last('one', 'mode').ended") is True
        page.page.keyboard.press("F9")
        page.wait("document.querySelector('#answers li')?.dataset.kind === 'done'")
        assert one.obeyed == ["stop"]
        page.context.close()


@pytest.mark.long
def test_without_a_boat_the_page_says_what_to_do(tmp_path, zenoh_port, browser):
    with console(tmp_path, zenoh_port) as address:
        page = Page(browser, address)
        page.wait(f"document.querySelector('#hears').innerText.includes('tcp/127.0.0.1:{zenoh_port}')")
        assert "aritra demo --shore" in page.text(".no-boat") and "[telemetry]" in page.text(".no-boat")
        assert page.text("#stop-whom") == "no boat" and page.page.locator("#plots").is_hidden()
        with boats(zenoh_port, "one"):
            page.wait("!document.querySelector('#stop').disabled")
            assert page.page.locator(".no-boat").is_hidden() and page.page.locator("#plots").is_visible()
        page.context.close()


@pytest.mark.long
def test_a_boat_without_a_position_is_not_drawn_and_names_of_thrusters_are_the_vessel_files(
    tmp_path, zenoh_port, browser
):
    with console(tmp_path, zenoh_port) as address, boats(zenoh_port, "one"):
        page = Page(browser, address)
        page.wait(
            "aritra.map.boats.get('one')?.made.has('hull') "
            "&& document.querySelectorAll('#thrusters .name').length === 4"
        )
        names = page.page.evaluate("aritra.history.last('one', 'about').thrusters.map((t) => t.name)")
        assert page.page.locator("#thrusters .name").all_inner_texts() == names
        for name in names:
            page.wait(f"[...document.querySelectorAll('.plot .legend')].some((l) => l.innerText.includes('{name}'))")
        drawn = page.page.evaluate(
            """() => { const view = aritra.history.at('one');
            aritra.map.show('lost', { ...view, state: { ...view.state, health: 'initialising' } }, { chosen: false });
            return [...aritra.map.boats.get('lost').made.keys()]; }"""
        )
        assert drawn == []
        page.context.close()


@pytest.mark.long
def test_the_boat_that_is_shown_can_be_read_under_the_pointer(tmp_path, zenoh_port, browser):
    """It was white on white."""
    with console(tmp_path, zenoh_port) as address, boats(zenoh_port, "one", "two"):
        page = Page(browser, address)
        page.wait("document.querySelectorAll('.boat[aria-pressed=true]').length === 1")
        for theme in ("light", "dark"):
            resize(page, 1440, theme)
            page.page.hover(".boat[aria-pressed=true]")
            ink, paper = page.page.evaluate(
                """() => { const s = getComputedStyle(document.querySelector('.boat[aria-pressed=true]'));
                const linear = (v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
                const light = (c) => { const [r, g, b] = c.match(/[\\d.]+/g).map((v) => linear(v / 255));
                  return 0.2126 * r + 0.7152 * g + 0.0722 * b; };
                return [light(s.color), light(s.backgroundColor)]; }"""
            )
            assert (max(ink, paper) + 0.05) / (min(ink, paper) + 0.05) > 7
        page.context.close()


def test_a_boat_out_of_reach_is_stopped_all_the_same_is_not_counted_and_can_come_back(tmp_path, zenoh_port, browser):
    """The rules, on boats made by hand: [age of the newest word, token, problem of the key, last mode]."""
    with console(tmp_path, zenoh_port) as address:
        page = Page(browser, address)
        told = page.page.evaluate(
            """async () => { const { Fleet } = await import('/web/fleet.js');
            const made = { live: [0, true, '', {}], lost: [60, false, '', {}], dead: [60, false, '', { ended: true }],
              forged: [0, true, '', { ended: true }], keyless: [0, true, 'no key', {}], deaf: [0, true, '', {}] };
            const newest = Object.fromEntries(Object.keys(made).map((boat) => [boat, 1]));
            const history = { boats: () => Object.keys(made), newest: (boat) => newest[boat],
              last: (boat, topic) => (topic === 'mode' ? made[boat][3] : { commands: boat !== 'deaf' }) };
            const clock = ([boat, [, there, problem]]) => [boat, [0, there, 1, problem]];
            const clocks = new Map(Object.entries(made).map(clock));
            const fleet = new Fleet(history, clocks, (boat) => made[boat][0]);
            const names = fleet.names();
            const before = { stoppable: fleet.stoppable(true), none: fleet.stoppable(false),
              lost: names.filter((b) => fleet.lost(b)), doubt: names.filter((b) => fleet.doubt(b)) };
            fleet.putAway('lost'); fleet.putAway('dead');
            const away = fleet.names();
            newest.lost = 2; clocks.get('dead')[1] = true;
            return { ...before, away, back: fleet.names() }; }"""
        )
        page.context.close()
    assert told["stoppable"] == ["live", "lost", "forged", "deaf"] and told["none"] == []
    assert told["lost"] == ["lost"] and told["doubt"] == ["lost", "deaf"]
    assert told["away"] == ["live", "forged", "keyless", "deaf"]
    assert told["back"] == ["live", "lost", "dead", "forged", "keyless", "deaf"]
