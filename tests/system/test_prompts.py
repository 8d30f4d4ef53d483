"""Prompts of commands that move: what they announce, what confirms them, and who may use the bus meanwhile."""

from __future__ import annotations

import io
import os
import pty
import sys

import click
import pytest

from gateway.cli import main
from gateway.commands.console import Session
from gateway.commands.guided import Terminal
from gateway.commands.motion_options import MoveChoice

pytestmark = pytest.mark.system
HEARTBEAT = "heartbeat is"


class Person:
    """Replacement of stdin: at each prompt another function answers; then there is no further input."""

    def __init__(self, *answers):
        self._answers = list(answers)

    def readline(self, _size: int = -1):
        return self._answers.pop(0)() if self._answers else ""

    def isatty(self):
        return False


@pytest.fixture
def terminal():
    return Terminal(Session(), "small", MoveChoice(100, False, True, None))


@pytest.mark.parametrize(
    ("typed", "label", "confirmed"),
    [
        ("tool\n", "tool", True),
        ("  tool \n", "tool", True),
        ("YES\n", "tool", True),
        ("none\n", "none", True),
        ("\n\nTool\ny\ntool\n", "tool", True),
        ("\n", "tool", False),
        ("Tool\n", "tool", False),
        ("", "tool", False),
        ("\n" * 1000, "tool", False),
    ],
)
def test_a_load_is_mounted_when_its_label_or_yes_is_typed(terminal, monkeypatch, capsys, typed, label, confirmed):
    monkeypatch.setattr(sys, "stdin", io.StringIO(typed))
    if confirmed:
        terminal.mount(label)
    else:
        with pytest.raises(click.Abort):
            terminal.mount(label)
    assert len(capsys.readouterr().out.splitlines()) == 1, "scripts read one line for one load"


def test_what_was_typed_before_the_prompt_does_not_confirm_it(terminal, monkeypatch):
    master, slave = pty.openpty()
    with open(slave, encoding="utf-8") as keyboard:
        monkeypatch.setattr(sys, "stdin", keyboard)
        os.write(master, b"yes\ntool\n")
        asked = click.echo

        def answer(text: str) -> None:
            asked(text)
            os.write(master, b"\nnot yet\ntool\nrest\n")

        monkeypatch.setattr(click, "echo", answer)
        terminal.mount("tool")
        assert keyboard.readline() == "rest\n", "the prompt has read three lines, of which the last one confirms it"
    os.close(master)


@pytest.mark.parametrize("command", ["check", "move"])
def test_while_a_question_is_open_no_other_command_uses_the_bus(place, serve, monkeypatch, gateway, command):
    drives, done = serve(), []

    def another_command():
        more = ("--to", "home", "--yes") if command == "move" else ()
        done.append(gateway(command, place.cell, "--bus", drives.bus, *more))
        return "n\n"

    monkeypatch.setattr(sys, "stdin", Person(another_command))
    options = ["--load", "none", "-o", str(place.run), "--bus", drives.bus]
    with pytest.raises(SystemExit) as left:
        main(["record", str(place.cell), *options])
    assert left.value.code == 130
    assert done[0].exit_code == 4
    assert f"{drives.bus} is in use by process {os.getpid()} (servo-gateway record)" in done[0].stderr
    assert drives.handle.simulation.servers[0].sync_count == 0
    assert gateway("check", place.cell, "--bus", drives.bus).exit_code == 0, "the lock ends with the command"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "asks"),
    [
        (("move", "--to", "home"), [HEARTBEAT]),
        (("record", "--load", "none", "-o", "run.h5"), [HEARTBEAT, "Is the flange empty?"]),
        (("record", "--load", "tool", "-o", "run.h5"), [HEARTBEAT]),
        (("commission", "--out", "out"), [HEARTBEAT, "Is the flange empty?"]),
        (("calibrate", "--known", "load=6.0", "--out", "out"), [HEARTBEAT, "Is the flange empty?"]),
        (("check", "--move"), [HEARTBEAT]),
    ],
)
def test_the_question_names_the_proof_of_the_stop_also_where_a_stored_one_is_void(
    place, serve, fast_arm, gateway, monkeypatch, command, asks
):
    monkeypatch.chdir(place.folder)
    drives = fast_arm(serve())
    store = drives.handle.simulation.arms[0].drives[3].store
    store.values[0x6085, 0] = 2 * store.number((0x6085, 0))
    name, *more = command
    done = gateway(name, place.cell, "--bus", drives.bus, *more, input="n\n")
    assert done.exit_code == 130, done.output
    (question,) = [line for line in done.output.splitlines() if "Is the area clear" in line]
    assert [text for text in (HEARTBEAT, "Is the flange empty?") if text in question] == asks


def test_a_declined_move_does_not_say_that_nothing_was_written(place, serve, gateway):
    drives = serve()
    done = gateway("move", place.cell, "--bus", drives.bus, "--to", "home", input="n\n")
    assert done.exit_code == 130
    limits = [drive.store.number((0x6072, 0)) for drive in drives.handle.simulation.arms[0].drives]
    assert min(limits) < 3750, "the torque limits of this arm are written before the question"
    assert "nothing was written" not in done.stderr
    assert "servo-gateway restore" in done.stderr
