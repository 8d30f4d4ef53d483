"""The command lines of gateway and simulator, in the process of a test: run, or parsed alone."""

from __future__ import annotations

import shlex

import click
from click.testing import CliRunner, Result

from gateway.cli import main
from sim.__main__ import main as simulator

PROGRAMS = {"servo-gateway": main, "servo-sim": simulator}


def run(*words: object, **options: object) -> Result:
    """Run a command; lines of 200 characters are not wrapped."""
    return CliRunner(env={"COLUMNS": "200"}).invoke(main, [str(word) for word in words], **options)


def parse_typed(line: str) -> list[str]:
    """Return the words of a command line after the program, which its command can parse; nothing is run."""
    program, *words = shlex.split(line)
    command, rest = PROGRAMS[program], words
    while isinstance(command, click.Group):
        command, rest = command.get_command(click.Context(command), rest[0]), rest[1:]
    parser = command.make_parser(click.Context(command, **main.context_settings | command.context_settings))
    values, superfluous, _ = parser.parse_args(list(rest))
    assert not superfluous, (line, superfluous)
    for option in command.params:
        value = values.get(option.name)
        assert value or not option.required, (line, option.name)
        if isinstance(option.type, click.Choice) and isinstance(value, str):
            assert value in option.type.choices, (line, value)
    return words
