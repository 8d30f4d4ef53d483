"""Command `completion`: script for shell completion of commands, options and choices."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

from gateway.commands.shared_options import common
from gateway.errors import ConfigError

SHELLS = ("bash", "zsh", "fish")


@click.command()
@click.argument("shell", type=click.Choice(SHELLS))
@common
@click.pass_context
def completion(ctx: click.Context, shell: str) -> None:
    """Print the shell script that completes commands and options; to install it see docs/how-to/install.md.

    \b
    Example:
      servo-gateway completion bash
    """
    root = ctx.find_root()
    program = root.info_name or "servo-gateway"
    variable = f"_{program.replace('-', '_').upper()}_COMPLETE"
    kind = get_completion_class(shell)
    if kind is None:
        raise ConfigError(f"this version of click does not support {shell}; update it: pip install --upgrade click")
    click.echo(kind(root.command, {}, program, variable).source())
