"""Nothing is written over: the same words from every command, before any work is done."""

import pytest

from companion.boat.load_run import EXAMPLES
from companion.cli.options.outputs import AWAY, making, new_file, new_in_folder
from companion.core.configuration.tables import ConfigError
from tests.companion.command_line import exit_code

VESSEL, PLAN = EXAMPLES / "boats" / "aritra.toml", EXAMPLES / "excitations" / "library.toml"


def test_a_new_file_and_what_is_none(tmp_path):
    new_file(None)
    new_file(tmp_path / "a.png")
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    for path, told in ((tmp_path, "is a folder"), (tmp_path / "link", AWAY), (tmp_path / "no" / "a", "is no folder")):
        with pytest.raises(ConfigError, match=f"^{path}: .*{told}"):
            new_file(path)


def test_a_folder_is_made_or_has_room(tmp_path):
    new_in_folder(tmp_path / "a" / "b", ("x",))
    (tmp_path / "a" / "b" / "x").touch()
    new_in_folder(tmp_path / "a" / "b", ("y",))
    for folder, told in ((tmp_path / "a" / "b", "b/x: exists already"), (tmp_path / "a/b/x", "x: is a file")):
        with pytest.raises(ConfigError, match=told):
            new_in_folder(folder, ("x",))


@pytest.mark.parametrize(
    ("end", "told"),
    [
        (OSError(28, "No space left on device"), "x: No space left on device"),
        (OSError("File too large (os error 27)"), "x: File too large"),
        (ValueError("cannot be drawn"), "x: cannot be drawn"),
        (KeyboardInterrupt(), "^$"),
        (TypeError("a mistake of ours"), "^a mistake of ours"),
    ],
    ids=repr,
)
@pytest.mark.parametrize("folder", [False, True])
def test_what_was_begun_goes_however_it_ends(tmp_path, end, told, folder):
    path = tmp_path / "x"
    with pytest.raises(BaseException, match=told) as error, making(path, ValueError):
        if folder:
            path.mkdir()
        (path / "inside" if folder else path).write_text("half")
        raise end
    assert isinstance(error.value, ConfigError) is ("x: " in told)
    assert not path.exists()


def test_what_was_there_before_stays(tmp_path):
    (tmp_path / "x").write_text("mine")
    with pytest.raises(ConfigError, match=f"x: {AWAY}"), making(tmp_path / "x"):
        pytest.fail("it may not begin")
    assert (tmp_path / "x").read_text() == "mine"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("a.png", ("log", "plot", "LOG", "-o", "OUT")),
        ("a.pdf", ("log", "plot", "LOG", "--print", "column", "--out", "OUT")),
        ("a.html", ("log", "page", "LOG", "--no-ghosts", "-o", "OUT")),
        ("a.mcap", ("log", "recover", "LOG", "-o", "OUT")),
        ("a.geojson", ("log", "export", "LOG", "--geojson", "-o", "OUT")),
        ("a.csv", ("log", "export", "LOG", "-o", "OUT")),
        ("a.mcap", ("log", "export", "LOG", "--foxglove", "-o", "OUT")),
        ("bag", ("log", "export", "LOG", "--rosbag2", "-o", "OUT")),
        ("tick.csv", ("log", "export", "LOG", "--csv", "-o", "FOLDER")),
        ("identify.json", ("identify", "LOG", "--vessel", VESSEL, "-o", "FOLDER")),
        ("findings.json", ("diagnose", "LOG", "--vessel", VESSEL, "-o", "FOLDER")),
        ("plan.toml", ("excite", "design", "-o", "OUT")),
        ("run.mcap", ("excite", "fly", PLAN, "-o", "FOLDER")),
        ("a.json", ("bench", "--json", "OUT")),
        ("a.png", ("bench", "--growth", "--picture", "OUT")),
        ("run.mcap", ("run", "--log", "OUT")),
        ("truth.mcap", ("sim", "--truth", "OUT")),
    ],
    ids=lambda value: " ".join(map(str, value[:2])) if isinstance(value, tuple) else value,
)
def test_every_command_refuses_in_the_same_words(name, words, drive_log, tmp_path, capsys):
    out = tmp_path / "out" / name
    out.parent.mkdir()
    out.write_text("mine")
    places = {"LOG": drive_log(2.0), "OUT": out, "FOLDER": out.parent}
    assert exit_code(*(places.get(word, word) for word in words)) == 2
    assert f"{out}: {AWAY}\n" in capsys.readouterr().err
    assert out.read_text() == "mine" and list(out.parent.iterdir()) == [out]
