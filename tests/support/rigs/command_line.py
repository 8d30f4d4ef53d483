"""The command line of the gateway, run in the process of a test."""

from __future__ import annotations

from click.testing import CliRunner, Result

from gateway.cli import main


def run(*words: object, **options: object) -> Result:
    """Run a command; lines of 200 characters are not wrapped."""
    return CliRunner(env={"COLUMNS": "200"}).invoke(main, [str(word) for word in words], **options)
