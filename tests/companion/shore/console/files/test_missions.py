"""Mission files that the page opens: what the boat's loader reads, and its errors; and who may ask."""

import asyncio
from pathlib import Path

import pytest

from tests.support.console_server_fixture import serving

ROOT = Path(__file__).resolve().parents[5]
BASIN = {"lat_deg": 12.9915, "lon_deg": 80.2337, "rotation_deg": 0.0}


def read(body, **headers):
    async def play():
        async with serving() as desk:
            told = {"Origin": desk.url} | headers
            async with desk.http.post(f"{desk.url}/mission", json=body, headers=told) as answer:
                return answer.status, await (answer.json() if answer.status == 200 else answer.text())

    return asyncio.run(play())


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
