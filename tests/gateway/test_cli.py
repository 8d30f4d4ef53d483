"""The command line itself: fast help, lazy commands, one paragraph and one exit code for every error."""

import json
import re
import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from gateway import cli
from gateway.cli import main, paragraph
from gateway.errors import ConfigError, DataUnusable, FindingFailed, GatewayError, InputError, PlanRefused
from gateway.motion.stops import StoppedByPerson
from tests.support.rigs.command_line import parse_typed

EXAMPLE = Path(__file__).parents[2] / "examples" / "small" / "cell.toml"
RESULT = {
    "schema": 1,
    "robot": "small",
    "loads": [
        {"label": "tool", "mass_kg": 2.0, "mass_std_kg": 0.1, "com_m": [0, 0, 0.1], "com_flange_m": [0, 0, 0.08]},
    ],
}


def run(*arguments, **options):
    return CliRunner().invoke(cli.main, [str(argument) for argument in arguments], **options)


def test_help_imports_nothing_heavy():
    code = (
        "import sys\nfrom gateway.cli import COMMANDS, main\n"
        "for words in ([], *([name] for name in COMMANDS)):\n"
        "    try:\n        main([*words, '--help'])\n    except SystemExit:\n        pass\n"
        "heavy = {'numpy', 'scipy', 'can', 'canopen', 'pydantic', 'h5py', 'jinja2'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for name in cli.COMMANDS:
        assert name in done.stdout


def every_command(command, *words):
    """Every command, with the words that call it."""
    if isinstance(command, click.Group):
        for name in command.list_commands(click.Context(command)):
            yield from every_command(command.get_command(click.Context(command), name), *words, name)
    else:
        yield pytest.param(command, words, id=" ".join(words))


@pytest.mark.parametrize(("command", "words"), list(every_command(main)))
def test_the_help_of_a_command_has_an_example_that_can_be_typed(command, words):
    lines = [line.partition(" > ")[0] for line in command.help.splitlines() if line.strip().startswith(cli.PROGRAM)]
    assert lines
    for line in lines:
        assert tuple(parse_typed(f"{line} -v -q")[: len(words)]) == words


def test_unknown_command_and_missing_argument_are_usage_errors():
    for arguments in (["fly"], ["report"], ["export", "x.json", "--format", "staubli"], ["estimate"]):
        done = run(*arguments)
        assert done.exit_code == 2
        assert "Traceback" not in done.output


class WireError(Exception):
    exit_code = 4


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (GatewayError("what; where; what to do"), 1),
        (ConfigError("cell.toml: name: is missing"), 3),
        (InputError("a.csv:7: tau2_nm is NaN"), 3),
        (WireError("node 3:6077:00 (torque): no answer"), 4),
        (PlanRefused("pose 4 leaves the limits of J2"), 5),
        (DataUnusable("rank 3 of 4"), 6),
        (FindingFailed("J4: torque sign is reversed"), 7),
        (KeyboardInterrupt(), 130),
        (click.Abort(), 130),
    ],
)
def test_every_error_has_its_exit_code_and_is_one_paragraph(monkeypatch, error, code):
    @click.command()
    def broken():
        raise error

    monkeypatch.setattr(cli.LadderGroup, "get_command", lambda *_: broken)
    done = run("scan")
    assert done.exit_code == code
    assert done.stdout == ""
    assert len(done.stderr.strip().splitlines()) == 1
    assert "Traceback" not in done.stderr


def test_a_message_of_several_lines_becomes_one_paragraph_with_its_notes(monkeypatch):
    error = ConfigError("line one\n  line two")
    error.add_note("and a note")

    @click.command()
    def broken():
        raise error

    monkeypatch.setattr(cli.LadderGroup, "get_command", lambda *_: broken)
    assert run("scan").stderr == "error: line one line two; and a note\n"


def test_what_an_error_says_already_is_not_said_again_by_its_notes():
    error = ConfigError("node 3: gone; while stopping: node 3: no answer")
    for note in (
        "while stopping: node 3: no answer",
        "while stopping: node 3:  no answer",
        "It is SYNC 5.",
        "It is SYNC 5.",
    ):
        error.add_note(note)
    error.add_note("Look there.")
    assert paragraph(error) == "node 3: gone; while stopping: node 3: no answer. It is SYNC 5. Look there."


def test_a_defect_is_one_paragraph_and_its_details_are_in_a_file(monkeypatch):
    @click.command()
    def broken():
        raise ZeroDivisionError("division by zero")

    monkeypatch.setattr(cli.LadderGroup, "get_command", lambda *_: broken)
    done = run("scan")
    assert done.exit_code == 1
    assert len(done.stderr.strip().splitlines()) == 1
    path = done.stderr.split("The details are in ")[1].split(";")[0]
    with open(path, encoding="utf-8") as log:
        assert "ZeroDivisionError" in log.read()


def test_a_file_that_cannot_be_opened_is_an_input_error(monkeypatch, tmp_path):
    @click.command()
    def broken():
        (tmp_path / "nothing" / "x").write_text("")

    monkeypatch.setattr(cli.LadderGroup, "get_command", lambda *_: broken)
    done = run("scan")
    assert done.exit_code == 3
    assert str(tmp_path) in done.stderr


def test_quiet_says_nothing(tmp_path):
    source = tmp_path / "out.json"
    source.write_text(json.dumps(RESULT))
    done = run("report", source, "-o", tmp_path / "r.html", "-q")
    assert (done.exit_code, done.output) == (0, "")
    done = run("-q", "report", source, "-o", tmp_path / "r.html")
    assert (done.exit_code, done.output) == (0, "")


@pytest.mark.parametrize(
    "text",
    ["", "[]", "{", '{"schema": 2, "robot": "r", "loads": []}', '{"schema": 1}', '{"schema": 1, "robot": 3}'],
)
def test_a_file_that_is_no_result_is_refused_by_name(tmp_path, text):
    source = tmp_path / "out.json"
    source.write_text(text)
    for arguments in (["report", source, "-o", tmp_path / "r.html"], ["export", source, "--format", "abb"]):
        done = run(*arguments)
        assert done.exit_code == 3
        assert str(source) in done.stderr
    assert not (tmp_path / "r.html").exists()


def test_profiles_list_show_and_schema():
    listed = run("profiles", "list")
    assert listed.exit_code == 0
    assert "generic-cia402" in listed.stdout
    shown = run("profiles", "show", "generic-cia402")
    assert 'name = "generic-cia402"' in shown.stdout
    assert "properties" in json.loads(run("profiles", "schema").stdout)
    missing = run("profiles", "show", "no-such-drive")
    assert missing.exit_code == 3
    assert "generic-cia402" in missing.stderr


@pytest.mark.slow
def test_a_reader_that_leaves_is_no_error():
    words = [sys.executable, "-m", "gateway.cli", "plan", str(EXAMPLE)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as plan:
        plan.stdout.close()
        errors = plan.stderr.read()
    assert (plan.returncode, errors) == (0, "")


@pytest.mark.parametrize(
    ("before", "code"),
    [(None, 0), (StoppedByPerson("stopped by SIGTERM"), 130), (InputError("the disk is full"), 3)],
)
def test_a_closed_output_does_not_hide_how_the_command_ended(monkeypatch, before, code):
    closed = []
    monkeypatch.setattr(cli.os, "dup2", lambda _null, number: closed.append(number))

    def fail(*_arguments, **_options):
        try:
            if before is not None:
                raise before
        finally:
            raise BrokenPipeError

    monkeypatch.setattr(click.Group, "main", fail)
    with pytest.raises(SystemExit) as left:
        cli.main([])
    assert left.value.code == code


def test_the_signal_that_stopped_a_command_is_named(capsys):
    assert cli.report_error(StoppedByPerson("stopped by SIGTERM")) == 130
    assert "stopped by SIGTERM" in capsys.readouterr().err


def test_a_second_ctrl_c_while_the_program_ends_leaves_the_exit_code():
    code = (
        "import atexit, click, os, signal, sys, time\nfrom gateway import cli\n"
        "atexit.register(lambda: (os.kill(os.getpid(), signal.SIGINT), time.sleep(0.05)))\n"
        "@click.command()\ndef stopped():\n    raise KeyboardInterrupt\n"
        "cli.LadderGroup.get_command = lambda *_: stopped\n"
        "sys.argv = ['servo-gateway', 'stopped']\ncli.main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == cli.CTRL_C, done.stderr
    assert "Traceback" not in done.stderr


def test_a_full_disk_is_no_defect(capsys):
    assert cli.report_error(OSError(27, "File too large")) == 3
    assert "free some space" in capsys.readouterr().err


def test_a_defect_is_reported_even_where_no_log_can_be_written(monkeypatch, capsys):
    def full(**_options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tempfile.mkstemp", full)
    assert cli.report_error(ZeroDivisionError("by zero")) == 1
    assert "by zero" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP", "SIGINT"])
def test_a_signal_before_anything_moves_ends_the_program_with_its_code(name):
    program = (
        "import os, signal, sys, time\n"
        # as a terminal leaves them: a program in the background is started with some of them ignored
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "signal.signal(signal.SIGHUP, signal.SIG_DFL)\n"
        "from gateway import cli\nimport gateway.commands.console as console\n"
        f"console.Session = lambda **_: os.kill(os.getpid(), signal.{name}) or time.sleep(20)\n"
        "sys.argv = ['servo-gateway', 'plan', 'none.toml']\ncli.main()\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False, restore_signals=True
    )
    assert ended.returncode == 130, ended.stderr
    assert "stopped" in ended.stderr


@pytest.mark.slow
def test_signals_ignored_by_nohup_stay_ignored():
    program = (
        "import os, signal, sys\nfrom gateway import cli\nimport gateway.commands.console as console\n"
        "class Session(console.Session):\n"
        "    def __init__(self, **kept):\n"
        "        os.kill(os.getpid(), signal.SIGHUP)\n"
        "        super().__init__(**kept)\n"
        "console.Session = Session\n"
        "sys.argv = ['servo-gateway', 'plan', 'none.toml']\ncli.main()\n"
    )
    silenced = "import signal, subprocess, sys\nsignal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
    silenced += f"sys.exit(subprocess.run([sys.executable, '-c', {program!r}]).returncode)"
    ended = subprocess.run([sys.executable, "-c", silenced], capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 3, ended.stderr
    assert "none.toml" in ended.stderr


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (KeyboardInterrupt(), "stopped"),
        (StoppedByPerson("stopped by SIGTERM"), "stopped by SIGTERM"),
        (click.Abort(), "stopped"),
    ],
)
def test_an_interrupted_command_that_powered_no_arm_says_nothing_of_an_arm(capsys, error, said):
    assert cli.report_error(error) == 130
    assert capsys.readouterr().err == f"{said}\n"


def test_a_defect_says_nothing_of_motion(capsys):
    assert cli.report_error(ZeroDivisionError("division by zero")) == 1
    assert not re.search("motion|brakes|power", capsys.readouterr().err)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("estmate",), "No such command 'estmate'. Did you mean estimate?"),
        (("cell", "nwe"), "Did you mean 'new'?"),
        (("estimate", "--knwon", "x"), "'--known'?"),
        (("xyzzy",), "No such command 'xyzzy'.\n"),
    ],
)
def test_a_misspelled_command_or_option_is_answered_with_similar_names(words, says):
    done = CliRunner().invoke(main, list(words))
    assert done.exit_code == 2
    assert says in done.output
