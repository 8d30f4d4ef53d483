"""Option `--archive` of estimate and diagnose, which stores a measurement, and command `replay`."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import click

from gateway.commands.console import grid
from gateway.commands.shared_options import FILE, NEW_FILE, common, json_option, session_of, write_json
from gateway.errors import FindingFailed

#: Differences that are listed; more are counted.
_SHOWN: Final = 20

archive_option: Callable[..., Any] = click.option(
    "--archive",
    metavar="FILE.zip",
    type=NEW_FILE,
    help="Store data, cell, options, result and certificate, to be computed again by `replay`.",
)


@click.command()
@click.argument("file", metavar="FILE.zip", type=FILE)
@json_option
@common
def replay(file: Path, json_out: str | None) -> None:
    """Compute a stored measurement again and list what differs; exit 7 where a value differs by more than 1e-9.

    `estimate` and `diagnose` write such a file with --archive. A file of it that is missing or was edited is named.

    \b
    Example:
      servo-gateway replay measurement.zip
    """
    from gateway.jobs.replay import replay as run
    from gateway.result.compare import TOLERANCE

    session = session_of()
    found = run(file, say=session.note, working=session.working)
    listed = [{"where": each.where, "stored": each.stored, "again": each.again} for each in found]
    write_json(json_out, {"schema": 1, "file": str(file), "tolerance": TOLERANCE, "differences": listed})
    if found:
        rows = [[each.where, _short(each.stored), _short(each.again)] for each in found[:_SHOWN]]
        session.show(grid("what differs", ["value", "stored", "computed again"], rows, left=1))
        if len(found) > _SHOWN:
            session.show(f"and {len(found) - _SHOWN} more; --json OUT lists all of them")
        raise FindingFailed(f"{file}: {len(found)} values differ by more than {TOLERANCE:g} when computed again")
    session.show(f"{file}: every value is the same within {TOLERANCE:g} when computed again")


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
