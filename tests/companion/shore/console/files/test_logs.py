"""The list of logs, downloads, pages: who may, what leads out of the folder, what is not there any more."""

import asyncio
import os
from pathlib import Path
from urllib.parse import quote

import pytest

from companion.__main__ import main
from companion.shore.console.files import logs as module
from companion.shore.console.files.logs import SANDBOX, ServedLogs
from tests.companion.logs.page.page_logs import page_log
from tests.support.console_server_fixture import serving


@pytest.fixture
def folder(tmp_path):
    """A folder with two logs, one with a continuation, and what must not be shown."""
    made = tmp_path / "logs"
    (made / "sea" / "deep" / "deeper").mkdir(parents=True)
    for k, name in enumerate(
        ("a.mcap", "a.part1.mcap", "sea/b ü.mcap", "sea/deep/deeper/c.mcap", "x.txt", ".hidden.mcap")
    ):
        (made / name).write_bytes(name.encode())
        os.utime(made / name, (1000 + k, 1000 + k))
    (tmp_path / "secret.mcap").write_bytes(b"secret")
    (made / "link.mcap").symlink_to(tmp_path / "secret.mcap")
    (made / "away").symlink_to(tmp_path)
    return made


def ask(folder, *paths, token=None, **headers):
    """(status, headers, body) of each path, asked for one after the other."""

    async def play():
        logs = ServedLogs(folder)
        try:
            async with serving(token=token, logs=logs) as desk:
                answers = []
                for path in paths:
                    async with desk.http.get(desk.url + path, headers=headers) as answer:
                        answers.append((answer.status, answer.headers, await answer.read()))
                return answers
        finally:
            logs.close()

    return asyncio.run(play())


def test_logs_are_listed_the_newest_first_and_nothing_else(folder):
    ((status, _, data),) = ask(folder, "/logs")
    rows = module.msgspec.json.decode(data)
    assert status == 200
    assert [(row["name"], row["page"]) for row in rows] == [
        ("sea/b ü.mcap", True),
        ("a.part1.mcap", False),
        ("a.mcap", True),
    ]
    assert rows[0]["bytes"] == len("sea/b ü.mcap".encode()) and rows[0]["unix_s"] == 1002.0


def test_a_log_is_downloaded_whole_and_in_parts(folder):
    name = quote("sea/b ü.mcap")
    ((status, headers, data),) = ask(folder, f"/logs/file?name={name}")
    assert status == 200 and data == "sea/b ü.mcap".encode()
    assert headers["Content-Disposition"] == 'attachment; filename="b ?.mcap"'
    assert headers["Content-Type"] == "application/octet-stream" and headers["X-Content-Type-Options"] == "nosniff"
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    ((status, _, data),) = ask(folder, "/logs/file?name=a.mcap", Range="bytes=2-")
    assert (status, data) == (206, b"mcap")


@pytest.mark.parametrize("route", ["file", "page"])
@pytest.mark.parametrize(
    "name",
    ["", "../secret.mcap", "sea/../a.mcap", "/etc/passwd", "{folder}/a.mcap", "link.mcap", "away/secret.mcap", "x.txt",
     ".hidden.mcap", "sea", "sea/deep/deeper/c.mcap", "a.mcap\0", "..%2fsecret.mcap", "./a.mcap", "A.MCAP"],
)  # fmt: skip
def test_no_name_leads_out_of_the_list(folder, route, name):
    asked = name.replace("{folder}", str(folder))
    ((status, _, data),) = ask(folder, f"/logs/{route}?name={quote(asked)}")
    assert status == 404 and data == b"no such log: look at the list again"


def test_paths_of_the_address_lead_nowhere(folder):
    for status, _, _ in ask(
        folder, "/logs/a.mcap", "/logs/../secret.mcap", "/logs/file/a.mcap", "/logs/%2e%2e/secret.mcap"
    ):
        assert status == 404


@pytest.mark.parametrize("path", ["/logs", "/logs/file?name=a.mcap", "/logs/page?name=a.mcap"])
def test_strangers_get_none(folder, path):
    assert ask(folder, path, token="sesame-123")[0][0] == 403
    assert ask(folder, path, Host="rebound.example")[0][0] == 403
    assert ask(folder, path, Origin="http://evil.example")[0][0] == 403
    for site in ("cross-site", "same-site"):
        assert ask(folder, path, **{"Sec-Fetch-Site": site})[0][0] == 403, "a link of another site makes no work"


@pytest.mark.long
def test_a_page_is_made_once_in_a_sandbox_and_what_is_no_log_is_said(folder, monkeypatch):
    (folder / "a.part1.mcap").unlink()
    page_log(folder)
    made = []
    make = module.make_page

    async def counted(path, out):
        made.append(path.name)
        return await make(path, out)

    monkeypatch.setattr(module, "make_page", counted)
    page = "/logs/page?name=boat.mcap"
    first, again, broken = ask(folder, page, page, "/logs/page?name=a.mcap")
    assert first[0] == 200 and first[2].startswith(b"<!doctype html>") and again[2] == first[2]
    assert made == ["boat.mcap", "a.mcap"]
    policy = first[1]["Content-Security-Policy"]
    assert policy == SANDBOX and "allow-same-origin" not in policy and "connect-src" not in policy
    assert broken[0] == 422 and b"no page of a.mcap" in broken[2]


def test_without_the_option_there_is_nothing(folder):
    async def play():
        async with serving() as desk, desk.http.get(f"{desk.url}/logs") as answer:
            return answer.status

    assert asyncio.run(play()) == 404


def test_a_folder_that_is_not_there_is_an_error(tmp_path, capsys):
    assert main(["shore", "--port", "0", "--logs", str(tmp_path / "none")]) == 2
    assert f"--logs: {Path(tmp_path / 'none')}: no such folder" in capsys.readouterr().err
