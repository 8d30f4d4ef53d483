"""Lines for the person at the terminal, whatever the width."""

from __future__ import annotations

import pytest

from gateway.commands.console import Session

LINE = "/a/folder/with/a/long/name/as/they/are/on/a/shared/disk/run.h5: 4 periods under load none, 2 were there already"


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
