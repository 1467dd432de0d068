"""Figures for print: as wide as asked, with every panel, fonts in the file, and the same bytes for the same log."""

import pytest

from companion.cli import log as log_cli
from companion.logs.export.figure import printed
from companion.logs.log_file import LogFile
from companion.logs.series import collect
from tests.companion.command_line import exit_code


def run(*argv: object) -> int:
    return exit_code("log", "plot", *argv)


@pytest.mark.parametrize("width_mm", [88.0, 180.0])
@pytest.mark.long
def test_it_is_as_wide_as_asked_and_nothing_stands_outside(drive_log, width_mm):
    figure = printed(collect(LogFile(drive_log(10.0))), width_mm)
    assert figure.get_figwidth() == pytest.approx(width_mm / 25.4)
    labels = {axes.get_ylabel() for axes in figure.axes}
    assert labels >= {"north [m]", r"$\psi$ [deg]", r"$u, v$ [m s$^{-1}$]", r"$r$ [deg s$^{-1}$]", r"$y_e$ [m]"}
    figure.canvas.draw()
    whole = figure.bbox
    for axes in figure.axes:
        legend = axes.get_legend()
        for artist in [axes, legend] if legend else [axes]:
            box = artist.get_tightbbox()
            assert box.x0 >= whole.x0 - 1, artist
            assert box.x1 <= whole.x1 + 1, artist
            assert box.y1 <= whole.y1 + 1, artist


@pytest.mark.long
def test_a_pdf_has_its_fonts_inside_and_comes_out_the_same_twice(drive_log, tmp_path):
    log = drive_log(5.0)
    for name in ("a.pdf", "b.pdf"):
        assert run(log, "--print", "column", "-o", tmp_path / name) == log_cli.OK
    data = (tmp_path / "a.pdf").read_bytes()
    assert b"/FontFile2" in data
    assert b"/Type3" not in data
    assert b"drive.mcap" in data
    assert data == (tmp_path / "b.pdf").read_bytes()


@pytest.mark.long
def test_print_goes_beside_the_log_as_pdf_and_the_overview_as_png(drive_log):
    log = drive_log(2.0)
    assert run(log, "--print", "120") == run(log) == log_cli.OK
    assert log.with_suffix(".pdf").read_bytes().startswith(b"%PDF")
    assert log.with_suffix(".png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("width", ["wide", "3", "nan", "9999"])
def test_a_width_that_no_page_has_is_refused(width, drive_log, capsys):
    assert run(drive_log(2.0), "--print", width) == 2
    assert "expected column, page, or millimetres, 60 to 500" in capsys.readouterr().err
