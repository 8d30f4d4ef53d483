"""Command group `config`: read drive parameters into DCF files, compare, and write them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gateway.commands.console import grid
from gateway.commands.shared_options import (
    Function,
    agreed,
    bus_option,
    cell_argument,
    cell_context,
    common,
    confirm,
    json_option,
    junit_option,
    refuse_to_replace,
    session_of,
    show_remarks,
    write_json,
)
from gateway.errors import FindingFailed

if TYPE_CHECKING:
    from gateway.jobs.configure import ComparedNode

FOLDER = click.Path(path_type=Path, file_okay=False)
COLUMNS = ["object", "EDS default", "DCF", "drive", "type", "state"]
ALSO = "Also write this object, which sets a node id, a bit rate or a COB-ID of another node. Repeatable."


@click.group()
def config() -> None:
    """Configuration of the drives as device configuration files (DCF, CiA 306), one per node."""


def folder_option(*names: str, help: str) -> Callable[[Function], Function]:
    """Return the option for the folder of the DCF files."""
    return click.option(
        *names, "folder", type=FOLDER, metavar="DIR", help=f"{help}; default: dcf beside the cell file."
    )


@config.command("dump")
@cell_argument
@folder_option("-o", "--output", help="Folder for NODE.dcf")
@click.option("--eds", "sheets", multiple=True, metavar="[NODE=]FILE", help="EDS of a node whose profile names none.")
@bus_option
@json_option
@common
def config_dump(
    cell: Path, folder: Path | None, sheets: tuple[str, ...], bus_spec: str | None, json_out: str | None
) -> None:
    """Read every object in the EDS of every drive and write DIR/NODE.dcf. Nothing is written to a drive.

    Status and process values are not part of the configuration; --json lists them separately.

    \b
    Example:
      servo-gateway config dump cell.toml -o dcf
    """
    from gateway.jobs.configure import dcf_path, dump, few_objects

    context, session = cell_context(cell, bus_spec), session_of()
    by_node: dict[int | None, Path] = {}
    for stated in sheets:
        node, equals, name = stated.partition("=")
        key = int(node) if equals and node.isdecimal() else None
        if key in by_node:
            raise click.UsageError(f"--eds {stated}: two files for {'all nodes' if key is None else f'node {key}'}.")
        by_node[key] = Path(name if key is not None else stated)
    for arm in context.arms:
        for axis in arm.axis:
            refuse_to_replace(dcf_path(context, arm, axis.node_id, folder), "-o")

    def written(node: dict[str, Any]) -> None:
        unread, where = node["unread"], f"node {node['node_id']}"
        session.show(f"{where}: {node['file']}: {len(node['configuration'])} configuration objects")
        for name, why in unread.items():
            session.note(f"{where}: {name} is not in the file: {why}", level=1)
        for what in node["beyond_limits"]:
            session.show(f"  {what} of the data sheet; the drive has this value, so the limit is written as a comment")
        if unread:
            session.show(f"  {len(unread)} objects could not be read: {few_objects(unread)}")

    nodes = dump(context, folder=folder, sheets=by_node, remarks=show_remarks, written=written)
    if ours := sum(node["noted"] for node in nodes):
        session.show(
            f"{ours} objects hold values written by the gateway (write ledger); `restore` resets them to the original"
            " values"
        )
    write_json(json_out, {"schema": 1, "cell": context.loaded.cell.name, "nodes": nodes})


# ------------------------------------------------------------------------------------------------------- comparing


def _as_json(node: ComparedNode) -> dict[str, Any]:
    """Return all differing objects and the number compared, for JSON."""
    from gateway.jobs.configure import object_text, plain

    differences = [
        {
            "object": object_text(row.address),
            "name": row.name,
            "type": row.kind_and_unit,
            "default": plain(row.default) if row.default is not None else None,
            "dcf": plain(row.file),
            "drive": plain(row.drive) if row.drive is not None else None,
            "state": row.state,
        }
        for row in node.different
    ]
    return {
        "arm": node.arm,
        "node_id": node.drive.node_id,
        "file": str(node.file.path),
        "compared": len(node.rows),
        "said": node.said,
        "differences": differences,
    }


def _show(nodes: Sequence[ComparedNode]) -> None:
    session = session_of()
    for node in nodes:
        show_remarks(str(node.file.path), node.file.sheet.remarks)
        title = f"node {node.drive.node_id}: {len(node.different)} of {len(node.rows)} objects are different"
        for line in node.said:
            session.show(f"node {node.drive.node_id}: {line}")
        rows = [
            [row.name, row.text(row.default), row.text(row.file), row.text(row.drive), row.kind_and_unit, row.state]
            for row in (node.rows if session.verbosity > 0 else node.different)
        ]
        session.show(grid(title, COLUMNS, rows, left=1) if rows else title)


@config.command("diff")
@cell_argument
@folder_option("--dcf", help="Folder with NODE.dcf")
@junit_option
@bus_option
@json_option
@common
def config_diff(
    cell: Path, folder: Path | None, junit_file: Path | None, bus_spec: str | None, json_out: str | None
) -> None:
    """Compare the drives with their DCF and the EDS defaults. Nothing is written to a drive.

    Exit code 0 if every drive matches its file, otherwise 7.

    \b
    Example:
      servo-gateway config diff cell.toml --dcf dcf
    """
    from drives.files import replace_file
    from gateway.jobs.configure import compare_with_files

    context = cell_context(cell, bus_spec)
    nodes = compare_with_files(context, folder=folder)
    _show(nodes)
    name = context.loaded.cell.name
    if junit_file is not None:
        from gateway.result.junit import Case, junit_of

        cases = []
        for each in nodes:
            group = f"arm {each.arm} node {each.drive.node_id}"
            for row in each.rows:
                why = f"EDS {row.text(row.default)}, DCF {row.text(row.file)}, drive {row.text(row.drive)}"
                cases.append(Case(group, row.name) if row.state == "equal" else Case(group, row.name, row.state, why))
        replace_file(junit_file, junit_of(name, cases, datetime.now(UTC)))
    write_json(json_out, {"schema": 1, "cell": name, "nodes": [_as_json(node) for node in nodes]})
    odd = [node for node in nodes if node.different]
    if odd:
        first, node_id = odd[0].different[0], odd[0].drive.node_id
        more = sum(len(node.different) for node in odd) - 1
        what = f"node {node_id}:{first.name}: DCF {first.text(first.file)}, drive {first.text(first.drive)}"
        raise FindingFailed(
            f"drives differ from their DCF files: {what}{f' (and {more} more)' if more else ''}; "
            "`config apply` writes the files to the drives, `config dump` writes the drive values to files"
        )


# --------------------------------------------------------------------------------------------------------- writing


@config.command("apply")
@cell_argument
@folder_option("--dcf", help="Folder with NODE.dcf")
@click.option("--also", "also", multiple=True, metavar="INDEX:SUB", help=ALSO)
@click.option("--store", is_flag=True, help="Store the parameters in the drives for the next power-up (0x1010).")
@click.option("--yes", is_flag=True, help="Do not ask before writing.")
@bus_option
@json_option
@common
def config_apply(
    cell: Path,
    folder: Path | None,
    also: tuple[str, ...],
    store: bool,
    yes: bool,
    bus_spec: str | None,
    json_out: str | None,
) -> None:
    """Write the values of the DCF that differ to the drives and read them back. Asks first.

    `restore` undoes this until the next run configures the drives; from then on these values are the originals. Objects
    that a run has written and that are not yet restored are refused: run `restore` first. So is --store while a drive
    holds any value of a run (exit code 5), because a drive stores all its parameters.

    Node ids, bit rates and COB-IDs of other nodes are confirmed one by one, also with --yes. Objects that trigger an
    action (save, load, reset) are never written. The drives must be disabled. If a drive refuses a value, all values
    written before are restored.

    \b
    Example:
      servo-gateway config apply cell.toml --dcf dcf
    """
    from gateway.jobs.configure import apply_files, object_text
    from gateway.jobs.frame import Operator

    context, session = cell_context(cell, bus_spec), session_of()

    def ask(question: str, meanwhile: Callable[[], None]) -> None:
        if not yes:
            confirm(question, "declined: nothing was written to the drives of this arm", meanwhile)

    nodes = apply_files(
        context,
        Operator(ask=ask, say=session.show),
        folder=folder,
        also={_address(text) for text in also},
        store=store,
        allow=lambda change: not yes and sys.stdin.isatty() and agreed(f"{change}. Write it anyway?"),
        compared=_show,
    )
    listed = [
        _as_json(node) | {"stored": store, "left_out": [object_text(each) for each in node.left_out]} for node in nodes
    ]
    write_json(json_out, {"schema": 1, "cell": context.loaded.cell.name, "nodes": listed})


def _address(text: str) -> tuple[int, int]:
    index, _, subindex = text.partition(":")
    try:
        return int(index, 16), int(subindex or "0", 16)
    except ValueError:
        raise click.UsageError(f"--also {text}: give an object such as 2000:00.") from None
