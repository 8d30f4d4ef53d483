"""Command group `config`: read drive parameters into DCF files, compare, and write them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from drives.files import replace_file
from drives.objects import object_name
from gateway.commands.console import grid
from gateway.commands.shared_options import (
    Function,
    agreed,
    bus_option,
    cell_argument,
    common,
    confirm,
    json_option,
    output_option,
    refuse_to_replace,
    reserve,
    session_of,
    show_remarks,
    write_json,
    writes,
)
from gateway.errors import ConfigError, FindingFailed, PlanRefused

if TYPE_CHECKING:
    from drives.access import ObjectAccess
    from drives.configuration.dcf import BeyondLimit, NodeConfiguration
    from drives.configuration.difference import Compared, Readout
    from drives.drive import Cia402Drive
    from drives.nodes import Nodes
    from drives.pdo import Step
    from gateway.cell.config import ArmConfig
    from gateway.jobs.cell_context import CellContext

FOLDER = click.Path(path_type=Path, file_okay=False)
COLUMNS = ["object", "EDS default", "DCF", "drive", "type", "state"]
ALSO = "Also write this object, which sets a node id, a bit rate or a COB-ID of another node. Repeatable."
#: Folder of the DCF files, beside the cell file.
BESIDE = "dcf"


@click.group()
def config() -> None:
    """Configuration of the drives as device configuration files (DCF, CiA 306), one per node."""


def folder_option(name: str, help: str) -> Callable[[Function], Function]:
    """Return the option for the folder of the DCF files."""
    return click.option(name, "folder", type=FOLDER, metavar="DIR", help=f"{help}; default: dcf beside the cell file.")


@config.command("dump")
@cell_argument
@writes(folder_option("--output", "Folder for NODE.dcf"))
@click.option("--eds", "sheets", multiple=True, metavar="[NODE=]FILE", help="EDS of a node whose profile names none.")
@bus_option
@json_option
@common
def config_dump(
    cell: Path, folder: Path | None, sheets: tuple[str, ...], bus_spec: str | None, json_out: str | None
) -> None:
    """Read every object in the EDS of every drive and write DIR/NODE.dcf. Nothing is written to a drive.

    Status and process values are not part of the configuration; --json lists them separately.
    """
    from drives.configuration.dcf import beyond_limits
    from drives.configuration.difference import read_drive
    from drives.datasheet.building import read_sheet
    from gateway.jobs.cell_context import open_cell

    context, session = open_cell(cell, bus_spec, reserve), session_of()
    by_node: dict[int | None, Path] = {}
    for stated in sheets:
        node, equals, name = stated.partition("=")
        key = int(node) if equals and node.isdecimal() else None
        if key in by_node:
            raise click.UsageError(f"--eds {stated}: two files for {'all nodes' if key is None else f'node {key}'}.")
        by_node[key] = Path(name if key is not None else stated)
    nodes: list[dict[str, Any]] = []
    for arm in context.arms:
        paths = {axis.node_id: _path(context, arm, axis.node_id, folder) for axis in arm.axis}
        sources = _sources(context, arm, by_node)
        for path in paths.values():
            refuse_to_replace(path, "--output", session)
        sheets_read = {source: read_sheet(source) for source in set(sources.values())}
        read = {node_id: sheets_read[source] for node_id, source in sources.items()}
        for source, sheet in sheets_read.items():
            show_remarks(str(source), sheet.remarks)
        with context.connected(arm) as connected:
            found = [(drive, read_drive(drive.access, read[drive.node_id])) for drive in connected.drives]
            ours = len(connected.noted)
            if ours:
                session_of().show(
                    f"{ours} objects hold values written by the gateway (write ledger); `restore` resets them to the "
                    f"original values"
                )
        for joint, (drive, readout) in enumerate(found, start=1):
            node_id = drive.node_id
            beyond = beyond_limits(read[node_id], _stored(readout), node_id)
            text = _text_of((context, arm, joint), drive, readout, sources[node_id], beyond)
            replace_file(paths[node_id], text)
            said = [what for _, _, what in beyond]
            nodes.append(_dumped(arm, readout, paths[node_id]) | {"beyond_limits": said})
            held = readout.of_kind("configuration")
            session.show(f"node {node_id}: {paths[node_id]}: {len(held)} configuration objects")
            for address, why in readout.unread.items():
                session.note(f"node {node_id}: {_named(address)} is not in the file: {why}", level=1)
            for what in said:
                session.show(
                    f"  {what} of the data sheet; the drive has this value, so the limit is written as a comment"
                )
            if readout.unread:
                session.show(f"  {len(readout.unread)} objects could not be read: {_few(readout.unread)}")
    if json_out:
        write_json(json_out, {"schema": 1, "cell": context.loaded.cell.name, "nodes": nodes})


def _sources(context: CellContext, arm: ArmConfig, by_node: dict[int | None, Path]) -> dict[int, Path]:
    """Return the data sheet of each node: from the command line, otherwise from its profile.

    Raises
    ------
    ConfigError
        Some nodes have none; the error lists all of them.
    """
    sources: dict[int, Path] = {}
    lacking: list[str] = []
    for axis, profile in zip(arm.axis, context.profiles(arm), strict=True):
        path = by_node.get(axis.node_id, by_node.get(None, profile.eds_path))
        if path is None:
            lacking.append(f"node {axis.node_id}: profile {profile.name} names no data sheet (eds)")
        else:
            sources[axis.node_id] = path
    if lacking:
        raise ConfigError(f"{'; '.join(lacking)}: give the maker's EDS by --eds NODE=FILE, or name it in the profile")
    return sources


def _path(context: CellContext, arm: ArmConfig, node_id: int, folder: Path | None) -> Path:
    """Return the file of a node; each arm of several has its own folder, because node ids repeat on other buses."""
    base = folder if folder is not None else context.path.parent / BESIDE
    return (base / arm.name if len(context.arms) > 1 else base) / f"{node_id}.dcf"


def _text_of(
    axis: tuple[CellContext, ArmConfig, int],
    drive: Cia402Drive,
    readout: Readout,
    source: Path,
    beyond: Sequence[BeyondLimit],
) -> str:
    from drives.configuration.dcf import dcf_text

    context, arm, joint = axis
    bitrate = context.loaded.cell.bus[arm.bus].bitrate_bit_s
    name = f"{context.loaded.cell.name} {arm.name} J{joint}"
    return dcf_text(source, _stored(readout), datetime.now(UTC), drive.access.device, name, bitrate, arm.bus, beyond)


def _stored(readout: Readout) -> dict[tuple[int, int], Any]:
    """Return the content of the file of a node."""
    return readout.of_kind("configuration", "fixed")


def _dumped(arm: ArmConfig, readout: Readout, path: Path) -> dict[str, Any]:
    def listed(*kinds: Any) -> dict[str, Any]:
        return {_named(address): _plain(value) for address, value in readout.of_kind(*kinds).items()}

    return {
        "arm": arm.name,
        "node_id": readout.node_id,
        "file": str(path),
        "configuration": listed("configuration"),
        "fixed": listed("fixed"),
        "apart": listed("actual", "process", "command"),
        "unread": {_named(address): why for address, why in readout.unread.items()},
        "write_only": [_named(address) for address, kind in readout.kinds.items() if kind == "write only"],
    }


def _named(address: tuple[int, int]) -> str:
    return f"{address[0]:04X}:{address[1]:02X}"


def _few(addresses: Iterable[tuple[int, int]]) -> str:
    listed = [_named(address) for address in addresses]
    return ", ".join(listed[:6]) + (f" and {len(listed) - 6} more (list them with -v)" if len(listed) > 6 else "")


def _plain(value: object) -> object:
    """Return a value for JSON."""
    return value.hex() if isinstance(value, bytes) else value if isinstance(value, int | str) else repr(value)


# ------------------------------------------------------------------------------------------------------- comparing


@dataclass(frozen=True, slots=True)
class ComparedNode:
    """One drive compared with its DCF.

    Attributes
    ----------
    arm : str
    drive : Cia402Drive
    file : NodeConfiguration
    found : Readout
    rows : tuple of Compared
    said : list of str
        Other differences: firmware, serial number.
    """

    arm: str
    drive: Cia402Drive
    file: NodeConfiguration
    found: Readout
    rows: tuple[Compared, ...]
    said: list[str]

    @property
    def different(self) -> tuple[Compared, ...]:
        """Objects that differ between drive and file."""
        from drives.configuration.difference import differing

        return differing(self.rows)

    def as_json(self) -> dict[str, Any]:
        """Return all differing objects and the number compared, for JSON."""
        differences = [
            {
                "object": _named(row.address),
                "name": row.name,
                "type": row.kind_and_unit,
                "default": _plain(row.default) if row.default is not None else None,
                "dcf": _plain(row.file),
                "drive": _plain(row.drive) if row.drive is not None else None,
                "state": row.state,
            }
            for row in self.different
        ]
        return {
            "arm": self.arm,
            "node_id": self.drive.node_id,
            "file": str(self.file.path),
            "compared": len(self.rows),
            "said": self.said,
            "differences": differences,
        }


def _files(context: CellContext, arm: ArmConfig, folder: Path | None) -> dict[int, NodeConfiguration]:
    """Read the DCF files of an arm before anything is sent."""
    from drives.configuration.dcf import read_dcf

    paths = {axis.node_id: _path(context, arm, axis.node_id, folder) for axis in arm.axis}
    missing = [str(path) for path in paths.values() if not path.exists()]
    if missing:
        raise ConfigError(
            f"{', '.join(missing)}: file missing; create it from the drives with: servo-gateway config dump "
            f"{context.path}"
        )
    files = {node_id: read_dcf(path, node_id) for node_id, path in paths.items()}
    for file in files.values():
        show_remarks(str(file.path), file.sheet.remarks)
    return files


def _compared(arm: ArmConfig, connected: Nodes, files: dict[int, NodeConfiguration]) -> list[ComparedNode]:
    from drives.configuration.difference import compare, read_drive
    from drives.configuration.kinds import mapped_objects
    from drives.discovery import read_identity

    nodes = []
    said = {
        drive.node_id: files[drive.node_id].require_same_product(read_identity(drive.access.sdo))
        for drive in connected.drives
    }
    for drive in connected.drives:
        file = files[drive.node_id]
        found = read_drive(drive.access, file.sheet, mapped_objects(file.values))
        rows = compare(file, found)
        if not rows:
            raise ConfigError(
                f"{file.path}: none of its {len(file.values)} values is a configuration object: nothing to compare;"
                " use the file written by `config dump`, or another DCF of this drive"
            )
        actions = [address for address in file.values if found.kinds.get(address) == "command"]
        if actions:
            said[drive.node_id].append(f"never written, because they trigger an action in the drive: {_few(actions)}")
        nodes.append(ComparedNode(arm.name, drive, file, found, rows, said[drive.node_id]))
    return nodes


def _show(nodes: Sequence[ComparedNode]) -> None:
    session = session_of()
    for node in nodes:
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
@folder_option("--dcf", "Folder with NODE.dcf")
@output_option("--junit", "junit_file", metavar="FILE", help="Write the comparison as JUnit XML.")
@bus_option
@json_option
@common
def config_diff(
    cell: Path, folder: Path | None, junit_file: Path | None, bus_spec: str | None, json_out: str | None
) -> None:
    """Compare the drives with their DCF and the EDS defaults. Nothing is written to a drive.

    Exit code 0 if every drive matches its file, otherwise 7.
    """
    from gateway.jobs.cell_context import open_cell

    context = open_cell(cell, bus_spec, reserve)
    files = {arm.name: _files(context, arm, folder) for arm in context.arms}
    nodes: list[ComparedNode] = []
    for arm in context.arms:
        with context.connected(arm) as connected:
            nodes += _compared(arm, connected, files[arm.name])
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
    if json_out:
        write_json(json_out, {"schema": 1, "cell": name, "nodes": [node.as_json() for node in nodes]})
    odd = [node for node in nodes if node.different]
    if odd:
        first = odd[0].different[0]
        more = sum(len(node.different) for node in odd) - 1
        what = (
            f"node {odd[0].drive.node_id}:{first.name}: DCF {first.text(first.file)}, drive {first.text(first.drive)}"
        )
        raise FindingFailed(
            f"drives differ from their DCF files: {what}{f' (and {more} more)' if more else ''}; "
            "`config apply` writes the files to the drives, `config dump` writes the drive values to files"
        )


# --------------------------------------------------------------------------------------------------------- writing


@config.command("apply")
@cell_argument
@folder_option("--dcf", "Folder with NODE.dcf")
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
    """
    from drives.configuration.applying import planned_writes, require_at_rest, write_all
    from drives.configuration.applying import store as keep
    from gateway.jobs.cell_context import open_cell

    context = open_cell(cell, bus_spec, reserve)
    files = {arm.name: _files(context, arm, folder) for arm in context.arms}
    done: list[dict[str, Any]] = []
    for arm in context.arms:
        with context.connected(arm) as connected:
            accesses = [drive.access for drive in connected.drives]
            require_at_rest(accesses)
            if store:
                _refuse_values_of_runs(context, accesses)
            nodes = _compared(arm, connected, files[arm.name])
            _show(nodes)
            ids = [axis.node_id for each in context.arms if each.bus == arm.bus for axis in each.axis]
            left_out = {node.drive.node_id: _left_out(node, ids, also, ask=not yes) for node in nodes}
            work = [
                planned_writes(node.drive.access, node.file, node.found, node.rows, left_out[node.drive.node_id])
                for node in nodes
            ]
            counts = [len(node.different) - len(left_out[node.drive.node_id]) for node in nodes]
            if any(counts) or store:
                if not yes:
                    declined = f"declined: nothing was written to the drives of arm '{arm.name}'"
                    text = (
                        f"{sum(counts)} objects of {sum(map(bool, counts))} drives of arm '{arm.name}' will be written;"
                    )
                    text += " `restore` undoes this until the next run."
                    if store:
                        text += f" {len(counts)} drives then store all their parameters; `restore` does not undo that."
                    confirm(f"{text} Write them?", declined)
                require_at_rest(accesses)
            write_all(work, _report)
            for access in accesses if store else ():
                keep(access)
        done += [
            node.as_json() | {"stored": store, "left_out": [_named(each) for each in left_out[node.drive.node_id]]}
            for node in nodes
        ]
        written = sum(counts)
        said = f"{written} objects written and read back" if written else "nothing to write"
        session_of().show(f"arm {arm.name}: {said}{'; stored' if store else ''}")
    if json_out:
        write_json(json_out, {"schema": 1, "cell": context.loaded.cell.name, "nodes": done})


def _refuse_values_of_runs(context: CellContext, accesses: Sequence[ObjectAccess]) -> None:
    """Refuse to store the parameters of a drive that still holds a value written by a run of the gateway.

    A drive stores all its parameters at once. Values of an earlier `config apply` are the engineer's own.

    Raises
    ------
    PlanRefused
    """
    for access in accesses:
        entries = [entry for entry in access.noted if entry.writer != "applied"]
        if entries:
            more = f" and {len(entries) - 1} more objects" if len(entries) > 1 else ""
            raise PlanRefused(
                f"--store: {entries[0].where}{more} hold values of a run (write ledger), which the drive would keep for"
                f" ever; nothing was written to the drives of this arm; type `servo-gateway restore {context.path}`"
                " first, then `config apply --store`"
            )


def _report(node_id: int, step: Step) -> None:
    where = object_name(step.index, step.subindex)
    session_of().note(f"node {node_id}:{where}: {step.value:#x} written and read back", level=1)


def _left_out(node: ComparedNode, ids: Collection[int], also: Sequence[str], *, ask: bool) -> set[tuple[int, int]]:
    """Return the objects that are not written because they were not allowed one by one."""
    from drives.configuration.applying import questions

    session, left_out = session_of(), set[tuple[int, int]]()
    allowed = {_address(text) for text in also}
    for row, why in questions(node.file, node.rows, ids):
        where = f"node {node.drive.node_id}:{row.name}: {row.text(row.drive)} becomes {row.text(row.file)}"
        if row.address in allowed:
            continue
        if ask and sys.stdin.isatty() and agreed(f"{where}: {why}. Write it anyway?"):
            continue
        left_out.add(row.address)
        session.show(f"not written: {where}: {why} (allow it with --also {_named(row.address)})")
    return left_out


def _address(text: str) -> tuple[int, int]:
    index, _, subindex = text.partition(":")
    try:
        return int(index, 16), int(subindex or "0", 16)
    except ValueError:
        raise click.UsageError(f"--also {text}: give an object such as 2000:00.") from None
