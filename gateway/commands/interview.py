"""Answers at the terminal: a line is read until it is valid."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TypeVar

import click

from gateway.errors import ConfigError

Value = TypeVar("Value")


def answer_of_line(key: str, read: Callable[[str], Value], *, optional: bool) -> Value | None:
    """Ask at the terminal until the answer is valid; None = an empty line, where it is allowed (`optional`).

    Raises
    ------
    ConfigError
        There is no terminal and no line; the error names the other ways of answering.
    """
    while True:
        try:
            line = click.prompt(f"  {key}", default="" if optional else None, show_default=False, err=True)
        except click.Abort as error:
            if sys.stdin.isatty():
                raise
            advice = f"write it into an answer file (--answers FILE), or --answer {key}=VALUE"
            raise ConfigError(f"{key}: no answer was given; {advice}") from error
        if optional and not line.strip():
            return None
        try:
            return read(line)
        except ValueError as error:
            click.echo(f"  {error}", err=True)
