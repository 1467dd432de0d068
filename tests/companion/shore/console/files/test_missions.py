"""Mission files that the page opens: what the boat's loader reads, and its errors; and who may ask."""

import asyncio
from pathlib import Path

import msgspec
import pytest

from companion.core.telemetry import structs as shore
from companion.core.telemetry import topics
from companion.core.telemetry.topics import Who
from tests.support.console_server_fixture import posted, serving
from tests.support.drive_fixture import setup

ROOT = Path(__file__).resolve().parents[5]
BASIN = {"lat_deg": 12.9915, "lon_deg": 80.2337, "rotation_deg": 0.0}


def read(body, **headers):
    return posted("mission", body, **headers)


def body(name, text, origin=BASIN):
    return {"file": {"name": name, "text": text}, "origin": origin}


@pytest.mark.parametrize("ending", ["toml", "plan", "waypoints", "geojson"])
def test_every_format_of_the_boat_is_read(ending):
    status, told = read(body(f"square.{ending}", (ROOT / f"deploy/missions/square.{ending}").read_text()))
    assert status == 200 and len(told["waypoints"]) == 5, told
    first = told["waypoints"][0]
    assert set(first) == {"north_m", "east_m", "speed_m_s", "acceptance_m"}


def test_what_is_wrong_is_named():
    status, told = read(body("a.toml", "[[waypoints]]\nnorth_m = 1.0\n[[waypoints]]\nnorth_m = 1.0\neast_m = inf\n"))
    assert status == 200 and told["errors"] == [
        "waypoints[0].east_m: missing key",
        "waypoints[1]: position is not finite",
    ]
    assert "is not a mission file" in read(body("a.txt", ""))[1]["errors"][0]
    square = (ROOT / "deploy/missions/square.plan").read_text()
    assert "need the site's origin" in read(body("square.plan", square, None))[1]["errors"][0]


def test_who_may_ask():
    assert read(body("a.toml", ""), Origin="http://evil.example")[0] == 403
    assert read(body("a.toml", "x" * 70_000))[0] == 400
    assert read({"file": {"name": "a.toml", "text": ""}, "more": 1})[0] == 400


def check(text, about):
    """What the console makes of a mission for a boat that reported `about`."""

    async def play():
        async with serving() as desk:
            if about:
                desk.console.store.take("b", "about", shore.encode(about), 0)
            body = {"boat": "b", "file": {"name": "a.toml", "text": text}}
            async with desk.http.post(f"{desk.url}/mission/check", json=body, headers={"Origin": desk.url}) as answer:
                return await answer.json()

    return asyncio.run(play())


def about_of(name):
    return topics.about(Who("run1", "digest", "aritra 0", 0, True), setup(vessel=name).pilot, 10**9)


def drawn(*places):
    return "".join(f"[[waypoints]]\nnorth_m = {n}\neast_m = {e}\n" for n, e in places)


def test_a_mission_is_checked_as_the_boat_would_and_its_course_is_told():
    told = check(drawn((9.0, 9.0), (15.0, 9.0), (15.0, 15.0)), about_of("aritra"))
    assert told["problems"] == [] and 11.5 < told["length_m"] < 12 and told["duration_s"] > 24
    assert told["course"][0] == [9, 9] and told["course"][-1] == pytest.approx([15, 15]) and len(told["course"]) > 5
    (far,) = check(drawn((9.0, 9.0), (500.0, 9.0)), about_of("aritra"))["problems"]
    assert far["at"] == 1 and far["grave"] and far["text"] == "Waypoint 2 lies 470.5 m beyond the fence."
    (same,) = check(drawn((9.0, 9.0), (9.0, 9.0)), about_of("aritra"))["problems"]
    assert same["at"] == 1 and "within 0.05 m" in same["text"]


def test_a_corner_without_room_is_found_at_its_waypoint():
    (tight,) = check(drawn((9.0, 9.0), (15.0, 9.0), (15.0, 10.5)), about_of("rudder"))["problems"]
    assert tight["at"] == 1 and "Waypoint 2 cannot be rounded: the turn of 90 deg" in tight["text"]


def test_a_boat_that_does_not_report_how_it_is_guided_is_checked_less():
    text = drawn((9.0, 9.0), (500.0, 9.0))
    assert (
        check(text, None) == {"problems": []} == check(text, msgspec.structs.replace(about_of("aritra"), guidance=None))
    )
    forged = msgspec.structs.replace(about_of("aritra").guidance, cruise_m_s=-1.0)
    assert check(text, msgspec.structs.replace(about_of("aritra"), guidance=forged)) == {"problems": []}
