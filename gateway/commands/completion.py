"""completion: the script by which a shell completes commands, options and choices."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

from gateway.commands.shared_options import common, one_of
from gateway.errors import ConfigError

SHELLS = ("bash", "zsh", "fish")


@click.command()
@click.argument("shell", type=one_of(SHELLS))
@common
@click.pass_context
def completion(ctx: click.Context, shell: str) -> None:
    """Print the script that completes commands and options; docs/how-to/completion.md says where it goes."""
    root = ctx.find_root()
    program = root.info_name or "servo-gateway"
    variable = f"_{program.replace('-', '_').upper()}_COMPLETE"
    kind = get_completion_class(shell)
    if kind is None:
        raise ConfigError(f"this version of click completes no {shell}; update it: pip install --upgrade click")
    click.echo(kind(root.command, {}, program, variable).source())
