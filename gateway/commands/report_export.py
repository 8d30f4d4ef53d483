"""Commands `report`, `export` and `import`: pages, files for other programs, and logs of other programs."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from drives.files import replace_file
from gateway.commands.measure import arm_option
from gateway.commands.shared_options import FILE, NEW_FILE, common, json_option, page_option, session_of, write_json
from gateway.result.names import CERTIFICATE_FORMAT, EXPORT_FORMATS, RECORDING_FORMATS, REHEARSAL, TABLE_FORMAT

if TYPE_CHECKING:
    from gateway.formats.log_map import LogMap
    from gateway.result.result import Result


@click.command()
@click.argument("result", metavar="FILE", type=FILE)
@page_option(required=True)
@json_option
@common
def report(result: Path, output: Path, json_out: str | None) -> None:
    """Write one page from a result or a rehearsal. It opens offline and can be printed; PDF needs an installed browser.

    For a stopped recording, or its black box: the page shows the last seconds before the stop.

    \b
    Example:
      servo-gateway report diagnosis.json -o report.html
    """
    from gateway.commands.pages import write_page
    from gateway.data.table import is_recording
    from gateway.report.render import render
    from gateway.result.values import json_object, text_of

    if is_recording(result):
        from gateway.data.blackbox.box import read_box
        from gateway.data.blackbox.ring_buffer import recover_box
        from gateway.errors import InputError
        from gateway.report.stop import render_stop

        path = recover_box(result)
        if path != result and not path.exists():
            raise InputError(
                f"{result}: no black box ({path.name}) beside it, because the run was not stopped; for a report of the "
                "measurement give the OUT.json of estimate or diagnose"
            )
        box = read_box(path)
        page, summary = render_stop(box), {"recording": box.recording, "reason": box.reason}
    elif result.is_file() and json_object(text_of(result, "name a result"), str(result)).get("kind") == REHEARSAL:
        from gateway.report.rehearsal_page import render_rehearsal
        from gateway.result.origin import Origin, in_words, read_rehearsal, software

        answer = read_rehearsal(result)
        page = render_rehearsal(answer, Origin(in_words(datetime.now(UTC)), software()))
        summary = {"robot": answer["robot"], "arm": answer["arm"]}
    else:
        held = _read_result(result)
        page, summary = render(held), {"robot": held.robot, "verdict": held.verdict}
    write_page(output, page)
    write_json(json_out, {"schema": 1, "report": str(output), **summary})
    session_of().show(f"report: {output}")


@click.command()
@click.argument("result", metavar="OUT.json|CELL.loads.json|RUN.h5", type=FILE)
@click.option(
    "--format",
    "fmt",
    required=True,
    type=click.Choice([*EXPORT_FORMATS, CERTIFICATE_FORMAT, *RECORDING_FORMATS]),
    help=f"Output format; for RUN.h5 {', '.join(RECORDING_FORMATS)}.",
)
@click.option("--load", "label", metavar="LABEL", help="Export only this load.")
@arm_option
@click.option("-o", "--output", metavar="FILE", type=NEW_FILE, help="File to write; default: stdout.")
@common
def export(result: Path, fmt: str, label: str | None, arm_name: str | None, output: Path | None) -> None:
    """Export the load as URDF, JSON or in the syntax of a robot controller; or a recording as table or for other tools.

    dcc is a Digital Calibration Certificate (XML): values, expanded uncertainty, budget, traceability.

    CELL.loads.json gives one file with all its loads, CELL.loads.json#LABEL with one.

    csv is the measured table that `estimate` and `diagnose` read: two rows per pose, joint-side torque. The other
    formats of a recording contain every sample, with units.

    \b
    Example:
      servo-gateway export result.json --format abb -o load.mod
    """
    from drives.profile import is_assumed
    from gateway.data.table import is_recording
    from gateway.result.export import export as export_text
    from gateway.result.export import loads_of_library
    from gateway.result.library import SUFFIX

    if is_recording(result) != (fmt in RECORDING_FORMATS):
        kinds = f"{fmt} is" if fmt in RECORDING_FORMATS else f"{', '.join(RECORDING_FORMATS)} are"
        raise click.UsageError(f"--format {kinds} for a recording (.h5); the other formats are for a result (.json)")
    if fmt in RECORDING_FORMATS and fmt != TABLE_FORMAT:
        from gateway.formats.registry import FRAMES, exported

        if output is None:
            raise click.UsageError(f"--format {fmt} is a binary format: give a file with -o")
        content, count = exported(result, fmt, *(arm_name, label))
        replace_file(output, content)
        if not count:
            session_of().note(f"{result}: contains no sample yet; {output} contains only the metadata of the run")
        session_of().show(f"{fmt}: {output}, {count} {'frames' if fmt == FRAMES else 'samples'}")
        return
    if fmt == CERTIFICATE_FORMAT:
        _certificate(result, label, output)
        return
    if fmt == TABLE_FORMAT:
        from gateway.data.recording.reader import read
        from gateway.data.table import csv_of
        from gateway.errors import InputError

        recording = read(result)
        names = [arm.name for arm in recording.arms]
        if arm_name not in (None, *names) or (arm_name is None and len(names) > 1):
            raise InputError(f"{result}: contains the arms {', '.join(names) or 'none'}: choose one with --arm")
        table = recording.table(arm_name)
        if label is not None:
            if label not in recording.loads:
                raise InputError(f"{result}: load '{label}' not found; loads in the file: {', '.join(recording.loads)}")
            table = table.take(table.load == label)
        text = csv_of(table)
    else:
        held = loads_of_library(result) if result.name.endswith(SUFFIX) else _read_result(result)
        text = export_text(held, fmt, label)
        if held.data is not None and is_assumed(held.data.flange_source or ""):
            session_of().note(f"{result}: flange {held.data.flange_source}; state flange_rpy_rad in the cell file")
    _write(text, fmt, output)


def _write(text: str, fmt: str, output: Path | None) -> None:
    """Write an export to its file, or to stdout."""
    if output is None:
        click.echo(text, nl=False)
    else:
        replace_file(output, text)
        session_of().show(f"{fmt}: {output}")


def _certificate(path: Path, label: str | None, output: Path | None) -> None:
    """The certificate of a result; one that refuses a load is written too, and exits with 7."""
    from gateway.errors import DataUnusable, FindingFailed, InputError
    from gateway.result.certificate import NOT_TRACEABLE, certificate
    from gateway.result.dcc import certificate_xml

    held = _read_result(path)
    stated = certificate(held, label)
    if not stated.loads:
        labels = ", ".join(load.label for load in held.loads)
        if not labels:
            raise DataUnusable(f"{path}: holds no load to certify (servo-gateway estimate DATA --json OUT.json)")
        raise InputError(f"{path}: holds no load '{label}'; it holds: {labels}")
    _write(certificate_xml(held, label, datetime.now(UTC).date()), CERTIFICATE_FORMAT, output)
    if not stated.traceability.is_traceable:
        session_of().note(f"{path}: {NOT_TRACEABLE}: {stated.traceability.statement}")
    if stated.refused:
        first = stated.refused[0]
        raise FindingFailed(f"{path}: load '{first.label}' is refused, the certificate says so: {first.refused}")


@click.command("import")
@click.argument("log", metavar="FILE", type=FILE)
@click.option(
    "--map",
    "map_file",
    required=True,
    metavar="MAP.toml|NAME",
    type=FILE,
    help="Map file of the columns; or a built-in map: ur-rtde, kuka-rsi, abb-egm, ros-joint-states.",
)
@click.option("--load", "label", metavar="LABEL", help="Load of all rows.")
@click.option("--joints", metavar="NAME,NAME,..", help="Names of the joints in the log, in the order of the arm.")
@click.option("--dry-run", is_flag=True, help="Show first values, units, ranges and problems; write nothing.")
@click.option("-o", "--output", metavar="TABLE.csv", type=NEW_FILE, help="Measured table to write.")
@common
def import_(
    log: Path, map_file: Path, label: str | None, joints: str | None, dry_run: bool, output: Path | None
) -> None:
    """Convert the log of another program to a measured table: text columns, MCAP, or a ROS 2 bag (.db3).

    The map assigns columns of the log to columns of the table, with units and signs.

    \b
    Example:
      servo-gateway import log.csv --map ur-rtde --load gripper -o table.csv
    """
    from gateway.formats.log_map import read_map
    from gateway.formats.measured import table_from_log

    changes: dict[str, object] = {} if label is None else {"load": {"label": label}}
    if joints is not None:
        names = tuple(name.strip() for name in joints.split(","))
        changes |= {"joints": names, "axes": len(names)}
    log_map = read_map(map_file, changes)
    if dry_run:
        _preview(log, log_map)
        return
    if output is None:
        raise click.UsageError("give the table to write with -o, or inspect the log first with --dry-run")
    text, rows, remarks = table_from_log(log, log_map)
    replace_file(output, text)
    for remark in remarks:
        session_of().note(f"{log}: {remark}")
    session_of().show(f"{output}: {rows} rows")


def _preview(log: Path, log_map: LogMap) -> None:
    """Show first values, ranges and problems of a log."""
    from gateway.commands.console import grid
    from gateway.formats.measured import preview_of

    columns, remarks = preview_of(log, log_map)
    rows = [
        [each.name, each.source, each.remark, *("  ".join(f"{value:.5g}" for value in part) for part in
         (each.first, (each.least, each.most)))]
        for each in columns
    ]  # fmt: skip
    session = session_of()
    names = ["column", "from the log", "looks wrong", "first rows", "least, most"]
    session.show(grid(f"{log}, in the units of the table", names, rows, left=3))
    for remark in remarks:
        session.show(remark)


def _read_result(path: Path) -> Result:
    """Read a result that was not edited; a file without a checksum is accepted with a note."""
    from gateway.result.result import read_result

    result = read_result(path)
    if result.sha256 is None:
        session_of().note(f"{path}: has no sha256, so it cannot be checked whether it was edited")
    return result
