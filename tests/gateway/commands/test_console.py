"""Lines for the person at the terminal, whatever the width."""

from __future__ import annotations

import logging

import pytest

from gateway.cli import report_error
from gateway.commands.console import Session, findings_table, grid
from gateway.errors import InputError
from gateway.result.result import Finding

LINE = "/a/folder/with/a/long/name/as/they/are/on/a/shared/disk/run.h5: 4 periods under load none, 2 already recorded"


@pytest.mark.parametrize("data_on_stdout", [False, True])
def test_a_line_is_left_whole_in_a_narrow_console(monkeypatch, capsys, data_on_stdout):
    monkeypatch.setenv("COLUMNS", "40")
    session = Session(data_on_stdout=data_on_stdout)
    session.show(LINE)
    session.note(LINE)
    out, err = capsys.readouterr()
    assert (out + err).splitlines() == [LINE, LINE]


def test_square_brackets_are_units(capsys):
    Session().show("mass [kg]")
    assert capsys.readouterr().out == "mass [kg]\n"


#: What a drive's name or a label may hold to move the cursor, set the title, hide text or answer for the person.
HOSTILE = "drive\x1b]0;owned\x07\x1b[2J\x9b1A\r\x08\N{RIGHT-TO-LEFT OVERRIDE}end"


def _print_everything(session: Session) -> None:
    session.show(HOSTILE)
    session.note(HOSTILE)
    session.show(grid(HOSTILE, [HOSTILE], [[HOSTILE]]))
    session.show(findings_table([Finding("fail", HOSTILE, HOSTILE, HOSTILE)]))
    with session.progress(1.0, HOSTILE) as bar:
        bar.set(0.5, 1.0, HOSTILE)
    with session.working(HOSTILE), session.detached():
        logging.getLogger("drives").warning("%s", HOSTILE)


def test_nothing_that_is_printed_controls_the_terminal(capsys):
    _print_everything(Session())
    out, err = capsys.readouterr()
    assert out.count("drive") >= 5
    assert err.count("drive") >= 3
    assert (out + err).replace("\n", "").isprintable()


def test_a_terminal_gets_the_colours_of_the_program_and_nothing_of_a_name(monkeypatch, capsys):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("COLUMNS", "200")
    _print_everything(Session())
    out, err = capsys.readouterr()
    assert "\x1b[1;31m" in out  # the severity, red by the program
    for text in (out, err):
        for control in ("\x1b]0;", "\x1b[2J", "\x07", "\x9b", "\x08", "\N{RIGHT-TO-LEFT OVERRIDE}"):
            assert control not in text


def test_an_error_does_not_control_the_terminal(capsys):
    assert report_error(InputError(f"{HOSTILE}: cannot be read")) == 3
    err = capsys.readouterr().err
    assert "end: cannot be read" in err
    assert err.replace("\n", "").isprintable()
