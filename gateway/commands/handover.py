"""report, export, profiles: what leaves the room."""

from __future__ import annotations

from pathlib import Path

import click

from drives.files import replace_file
from gateway.commands.options import common, one_of, output_option, session_of, write_json
from gateway.result.export import FORMATS

RESULT = click.Path(path_type=Path, dir_okay=False)


@click.command()
@click.argument("result", metavar="OUT.json", type=RESULT)
@output_option("-o", "--output", required=True, metavar="REPORT.html", help="Page to write.")
@common
def report(result: Path, output: Path) -> None:
    """One HTML page from a result: it opens offline and prints on paper."""
    from gateway.report.render import render
    from gateway.result.result import read_result

    replace_file(output, render(read_result(result)))
    session_of().show(f"report: {output}")


@click.command()
@click.argument("result", metavar="OUT.json", type=RESULT)
@click.option("--format", "fmt", required=True, type=one_of(list(FORMATS)), help="Syntax to write.")
@click.option("--load", "label", metavar="LABEL", help="Only this load.")
@output_option("-o", "--output", metavar="FILE", help="File to write; stdout if omitted.")
@common
def export(result: Path, fmt: str, label: str | None, output: Path | None) -> None:
    """The load as URDF, JSON, or in the load syntax of a robot controller."""
    from gateway.result.export import export as export_text
    from gateway.result.result import read_result

    text = export_text(read_result(result), fmt, label)
    if output is None:
        click.echo(text, nl=False)
    else:
        replace_file(output, text)
        session_of().show(f"{fmt}: {output}")


@click.group()
def profiles() -> None:
    """Drive profiles: what each drive model's numbers mean."""


@profiles.command("list")
@common
def profiles_list() -> None:
    """Name, description and measured torque of every profile."""
    from drives.profile_file import list_profiles, load_profile
    from gateway.commands.console import grid

    rows = []
    for name in list_profiles():
        profile = load_profile(name)
        rows.append([name, profile.description, profile.torque.kind, profile.torque.nature])
    session_of().show(grid("drive profiles", ["name", "description", "torque", "nature"], rows, left=4))


@profiles.command("show")
@click.argument("name")
@common
def profiles_show(name: str) -> None:
    """The TOML text of one profile (a name of the list, or a file)."""
    from drives.profile_file import load_profile

    click.echo(load_profile(name).text, nl=False)


@profiles.command("schema")
@common
def profiles_schema() -> None:
    """JSON schema of a profile."""
    from drives.profile_file import profile_schema

    write_json("-", profile_schema())
