"""Prompts of commands that move: what they announce, what confirms them, and who may use the bus meanwhile."""

from __future__ import annotations

import io
import os
import pty
import sys
import threading
import tty
from contextlib import nullcontext
from types import SimpleNamespace

import click
import pytest

from drives.errors import DriveRebooted
from gateway.cli import main
from gateway.commands.console import Session
from gateway.commands.motion_options import MoveChoice
from gateway.commands.shared_options import confirm
from gateway.commands.terminal import terminal as operator_at
from gateway.motion.stops import StoppedByPerson
from sim.faults import act, fault_of
from sim.states import PdsState
from tests.support.rigs.brakes import in_brakes
from tests.system.conftest import with_few_poses

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
    return operator_at(Session(), MoveChoice(100, False, True, None))


class Waiting:
    """An open arm in its brakes; from the third look at the drives of an arm that is attended on, a drive is gone."""

    def __init__(self, looks: int = 1_000_000):
        self.config = SimpleNamespace(name="main")
        self.group, self.looks = self, looks

    def gate(self, *, full: bool):
        assert full, "before a person is called"
        return in_brakes(full=full)

    def attend(self):
        self.looks -= 1
        if self.looks < 0:
            raise DriveRebooted("restarted", node=1)


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
        terminal.mount(label, Waiting())
    else:
        with pytest.raises(click.Abort):
            terminal.mount(label, Waiting())
    assert len(capsys.readouterr().out.splitlines()) == 1, "scripts read one line for one load"


def test_what_was_typed_before_the_prompt_does_not_confirm_it(terminal, monkeypatch):
    master, slave = pty.openpty()
    with open(slave, encoding="utf-8") as keyboard:
        monkeypatch.setattr(sys, "stdin", keyboard)
        os.write(master, b"yes\ntool\n")
        asked = click.echo

        def answer(text: str, **how: bool) -> None:
            asked(text, **how)
            os.write(master, b"\nnot yet\ntool\nrest\n")

        monkeypatch.setattr(click, "echo", answer)
        terminal.mount("tool", Waiting())
        assert keyboard.readline() == "rest\n", "the prompt has read three lines, of which the last one confirms it"
    os.close(master)


@pytest.mark.parametrize(("typed", "agrees"), [(b"no\x7f\x7fy\n", True), (b"y\x7fn\n", False), (b"\n", False)])
def test_a_question_is_answered_by_a_line_also_where_keys_are_read_one_by_one(monkeypatch, typed, agrees):
    master, slave = pty.openpty()
    tty.setcbreak(slave)
    looks = iter([lambda: None, lambda: os.write(master, typed)])
    with open(slave, encoding="utf-8") as keyboard:
        monkeypatch.setattr(sys, "stdin", keyboard)
        os.write(master, b"y\n")  # typed ahead
        with nullcontext() if agrees else pytest.raises(click.Abort, match="declined"):
            confirm("Is the area clear?", "declined", lambda: next(looks, lambda: None)())
    os.close(master)


def test_a_terminal_that_is_closed_at_a_question_declines_it(monkeypatch):
    master, slave = pty.openpty()
    ends = iter([lambda: os.close(master)])
    with open(slave, encoding="utf-8") as keyboard:
        monkeypatch.setattr(sys, "stdin", keyboard)
        with pytest.raises(click.Abort, match="declined"):
            confirm("Is the area clear?", "declined", lambda: next(ends)())


def test_a_change_of_a_drive_ends_the_prompt_without_an_answer(terminal, monkeypatch):
    master, slave = pty.openpty()
    with open(slave, encoding="utf-8") as keyboard:
        monkeypatch.setattr(sys, "stdin", keyboard)
        with pytest.raises(DriveRebooted):
            terminal.mount("tool", Waiting(looks=3))
    os.close(master)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("happens", "code", "said"),
    [
        ("stop", 130, "every drive was read as disabled at"),
        ("reboot_keeps_all", 4, "node 3: restarted"),
        ("energised", 4, "use the emergency stop (node 3: OPERATION ENABLED)"),
        ("energised, stop", 130, "use the emergency stop (node 3: OPERATION ENABLED)"),
    ],
)
def test_what_happens_while_a_load_is_mounted_is_read_from_the_drives(
    place, serve, fast_arm, monkeypatch, capsys, happens, code, said
):
    """The arm was under power before; a person answers after something has happened to a drive."""
    with_few_poses(place)
    drives = fast_arm(serve())
    simulation = drives.handle.simulation
    done = threading.Event()

    def change() -> None:
        drive = simulation.arms[0].drives[2]
        if happens.startswith("energised"):
            drive.automaton.state = PdsState.OPERATION_ENABLED
        elif happens != "stop":
            act(simulation.servers[0].drives, fault_of(happens, node=3))
        done.set()

    def answer() -> str:
        simulation.servers[0].later(change)
        assert done.wait(10.0)
        if "stop" in happens:
            raise StoppedByPerson("stopped by SIGINT")
        return "yes\n"

    monkeypatch.setattr(sys, "stdin", Person(answer))
    words = ["commission", place.cell, "--bus", drives.bus, "--yes", "-o", place.folder / "out"]
    with pytest.raises(SystemExit) as left:
        main([str(word) for word in words])
    assert left.value.code == code
    error = capsys.readouterr().err.splitlines()[-1]
    assert said in error
    assert ("every drive was read as disabled" in error) is not happens.startswith("energised")


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
        (("commission", "-o", "out"), [HEARTBEAT, "Is the flange empty?"]),
        (("calibrate", "--known", "load=6.0", "-o", "out"), [HEARTBEAT, "Is the flange empty?"]),
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
