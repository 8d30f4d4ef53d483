"""Configuration of the drives of a cell: kept in DCF files (CiA 306), compared, written, and restored after runs."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, Final

from drives.configuration.applying import planned_writes, questions, require_at_rest, write_all
from drives.configuration.applying import store as keep
from drives.configuration.dcf import NodeConfiguration, beyond_limits, dcf_text, read_dcf
from drives.configuration.difference import Compared, Readout, compare, differing, read_drive
from drives.configuration.kinds import mapped_objects
from drives.datasheet.building import read_sheet
from drives.datasheet.sheet import Remark
from drives.discovery import read_identity
from drives.drive import Cia402Drive
from drives.errors import DriveError
from drives.files import replace_file
from drives.nodes import Nodes
from gateway.cell.config import ArmConfig
from gateway.errors import ConfigError, PlanRefused
from gateway.jobs.cell_context import CellContext
from gateway.jobs.frame import Operator

Address = tuple[int, int]
#: Folder of the DCF files, beside the cell file.
BESIDE: Final = "dcf"
#: Number of objects that a sentence names.
_NAMED: Final = 6


def dcf_path(context: CellContext, arm: ArmConfig, node_id: int, folder: Path | None = None) -> Path:
    """Return the DCF file of a node; each arm of several has its own folder, because node ids repeat on other buses."""
    base = folder if folder is not None else context.path.parent / BESIDE
    return (base / arm.name if len(context.arms) > 1 else base) / f"{node_id}.dcf"


def object_text(address: Address) -> str:
    """Return an object as index and subindex, for example 6060:00."""
    return f"{address[0]:04X}:{address[1]:02X}"


def few_objects(objects: Collection[str]) -> str:
    """Return the first objects as text, and how many more there are."""
    named = ", ".join(list(objects)[:_NAMED])
    return named + (f" and {len(objects) - _NAMED} more (list them with -v)" if len(objects) > _NAMED else "")


# --------------------------------------------------------------------------------------------------------- reading


def dump(
    context: CellContext,
    *,
    folder: Path | None = None,
    sheets: Mapping[int | None, Path] | None = None,
    remarks: Callable[[str, Sequence[Remark]], None] = lambda _name, _remarks: None,
    written: Callable[[dict[str, Any]], None] = lambda _node: None,
) -> list[dict[str, Any]]:
    """Read every object in the data sheet of every drive, and write a DCF file a node. Nothing is written to a drive.

    Parameters
    ----------
    context : CellContext
    folder : Path, optional
        Of the files; `dcf` beside the cell file by default.
    sheets : mapping, optional
        Data sheets by node id, or by None for all nodes, in place of those that the profiles name.
    remarks : callable
        Called with the name of a data sheet and its lines that are not used.
    written : callable
        Called with each node when its file is written.

    Returns
    -------
    list of dict
        Of each node `arm`, `node_id` and `file`. By object the values of `configuration`, `fixed` and `apart` (status
        and process values). By object why it is `unread`. Lists: objects that are `write_only`, values `beyond_limits`
        of the data sheet. `noted` is the number of objects that hold values written by the gateway.

    Raises
    ------
    ConfigError
        Nodes without data sheet, or one that cannot be read.
    DriveError
        A drive does not answer.
    """
    sources = {arm.name: _sources(context, arm, sheets or {}) for arm in context.arms}
    read = {source: read_sheet(source) for source in {file for files in sources.values() for file in files.values()}}
    for source, sheet in read.items():
        remarks(str(source), sheet.remarks)
    nodes: list[dict[str, Any]] = []
    for arm in context.arms:
        bitrate, files = context.loaded.cell.bus[arm.bus].bitrate_bit_s, sources[arm.name]
        with context.connected(arm) as connected:
            found = [(drive, read_drive(drive.access, read[files[drive.node_id]])) for drive in connected.drives]
            for joint, (drive, readout) in enumerate(found, start=1):
                source, name = files[drive.node_id], f"{context.loaded.cell.name} {arm.name} J{joint}"
                stored = readout.of_kind("configuration", "fixed")
                beyond = beyond_limits(read[source], stored, drive.node_id)
                path, device = dcf_path(context, arm, drive.node_id, folder), drive.access.device
                replace_file(path, dcf_text(source, stored, datetime.now(UTC), device, name, bitrate, arm.bus, beyond))
                node = {
                    "arm": arm.name,
                    "node_id": drive.node_id,
                    "file": str(path),
                    "configuration": _by_object(readout.of_kind("configuration")),
                    "fixed": _by_object(readout.of_kind("fixed")),
                    "apart": _by_object(readout.of_kind("actual", "process", "command")),
                    "unread": _by_object(readout.unread),
                    "write_only": [object_text(at) for at, kind in readout.kinds.items() if kind == "write only"],
                    "beyond_limits": [what for _, _, what in beyond],
                    "noted": len(drive.access.noted),
                }
                written(node)
                nodes.append(node)
    return nodes


def _by_object(values: Mapping[Address, Any]) -> dict[str, Any]:
    return {object_text(address): plain(value) for address, value in values.items()}


def plain(value: object) -> object:
    """Return the value of an object for JSON."""
    return value.hex() if isinstance(value, bytes) else value if isinstance(value, int | str) else repr(value)


def _sources(context: CellContext, arm: ArmConfig, sheets: Mapping[int | None, Path]) -> dict[int, Path]:
    """Return the data sheet of each node: the stated one, otherwise that of its profile; all that lack one at once."""
    sources: dict[int, Path] = {}
    lacking: list[str] = []
    for axis, profile in zip(arm.axis, context.profiles(arm), strict=True):
        path = sheets.get(axis.node_id, sheets.get(None, profile.eds_path))
        if path is None:
            lacking.append(f"node {axis.node_id}: profile {profile.name} names no data sheet (eds)")
        else:
            sources[axis.node_id] = path
    if lacking:
        raise ConfigError(f"{'; '.join(lacking)}: give the maker's EDS by --eds NODE=FILE, or name it in the profile")
    return sources


# ------------------------------------------------------------------------------------------------------- comparing


@dataclass(frozen=True, slots=True)
class ComparedNode:
    """One drive compared with its DCF file.

    Attributes
    ----------
    arm : str
    drive : Cia402Drive
    file : NodeConfiguration
    found : Readout
    rows : tuple of Compared
    said : list of str
        Other differences: firmware, serial number.
    left_out : set of (int, int)
        Objects that were not written because they were not allowed one by one.
    """

    arm: str
    drive: Cia402Drive
    file: NodeConfiguration
    found: Readout
    rows: tuple[Compared, ...]
    said: list[str]
    left_out: set[Address]

    @property
    def different(self) -> tuple[Compared, ...]:
        """Objects that differ between drive and file."""
        return differing(self.rows)


def compare_with_files(context: CellContext, *, folder: Path | None = None) -> list[ComparedNode]:
    """Compare every drive with its DCF file and the defaults of its data sheet. Nothing is written to a drive.

    Parameters
    ----------
    context : CellContext
    folder : Path, optional
        Of the files; `dcf` beside the cell file by default.

    Raises
    ------
    ConfigError
        A file is missing, or of another product, or holds nothing that can be compared.
    DriveError
        A drive does not answer.
    """
    files = {arm.name: _files(context, arm, folder) for arm in context.arms}
    nodes: list[ComparedNode] = []
    for arm in context.arms:
        with context.connected(arm) as connected:
            nodes += _compared(arm, connected, files[arm.name])
    return nodes


def _files(context: CellContext, arm: ArmConfig, folder: Path | None) -> dict[int, NodeConfiguration]:
    """Read the DCF files of an arm before anything is sent."""
    paths = {axis.node_id: dcf_path(context, arm, axis.node_id, folder) for axis in arm.axis}
    missing = [str(path) for path in paths.values() if not path.exists()]
    if missing:
        raise ConfigError(
            f"{', '.join(missing)}: file missing; create it from the drives with: servo-gateway config dump "
            f"{context.path}"
        )
    return {node_id: read_dcf(path, node_id) for node_id, path in paths.items()}


def _compared(arm: ArmConfig, connected: Nodes, files: dict[int, NodeConfiguration]) -> list[ComparedNode]:
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
        actions = [object_text(address) for address in file.values if found.kinds.get(address) == "command"]
        if actions:
            what = "never written, because they trigger an action in the drive"
            said[drive.node_id].append(f"{what}: {few_objects(actions)}")
        nodes.append(ComparedNode(arm.name, drive, file, found, rows, said[drive.node_id], set()))
    return nodes


# --------------------------------------------------------------------------------------------------------- writing


def apply_files(
    context: CellContext,
    operator: Operator,
    *,
    folder: Path | None = None,
    also: Collection[Address] = (),
    store: bool = False,
    allow: Callable[[str], bool] = lambda _question: False,
    compared: Callable[[Sequence[ComparedNode]], None] = lambda _nodes: None,
) -> list[ComparedNode]:
    """Write the values of the DCF files that differ to the drives, and read them back, after confirmation.

    Parameters
    ----------
    context : CellContext
    operator : Operator
        Is asked whether the objects may be written, and told which are not and, after each arm, how many were.
    folder : Path, optional
        Of the files; `dcf` beside the cell file by default.
    also : collection of (index, subindex)
        Node ids, bit rates and COB-IDs of other nodes that are written too.
    store : bool
        Have the drives keep all their parameters for the next power-up (0x1010).
    allow : callable
        Called with a question about one such object that is not in `also`; returns whether it is written.
    compared : callable
        Called with the comparison of the drives of an arm, before the questions.

    Returns
    -------
    list of ComparedNode
        What differed before.

    Raises
    ------
    ConfigError, ConfigurationRefused
        As `compare_with_files`; objects that cannot be written. Nothing was written.
    PlanRefused
        `store` while a drive holds a value of a run.
    DriveError
        A drive is enabled or refuses a value; what had been written is put back.
    """
    files = {arm.name: _files(context, arm, folder) for arm in context.arms}
    done: list[ComparedNode] = []
    for arm in context.arms:
        with context.connected(arm) as connected:
            accesses = [drive.access for drive in connected.drives]
            at_rest = partial(require_at_rest, accesses)
            at_rest()
            if store:
                _refuse_values_of_runs(context, connected)
            nodes = _compared(arm, connected, files[arm.name])
            compared(nodes)
            ids = [axis.node_id for each in context.arms if each.bus == arm.bus for axis in each.axis]
            for node in nodes:
                for row, why in questions(node.file, node.rows, ids):
                    change = f"node {node.drive.node_id}:{row.name}: {row.text(row.drive)} becomes {row.text(row.file)}"
                    if row.address not in also and not allow(f"{change}: {why}"):
                        node.left_out.add(row.address)
                        named = object_text(row.address)
                        operator.say(f"not written: {change}: {why} (allow it with --also {named})")
            work = [
                planned_writes(node.drive.access, node.file, node.found, node.rows, node.left_out) for node in nodes
            ]
            counts = [len(node.different) - len(node.left_out) for node in nodes]
            if any(counts) or store:
                question = f"{sum(counts)} objects of {sum(map(bool, counts))} drives of arm '{arm.name}' will be"
                question += " written; `restore` undoes this until the next run."
                if store:
                    question += f" {len(counts)} drives then store all their parameters; `restore` does not undo that."
                operator.ask(f"{question} Write them?", at_rest)
                at_rest()
            write_all(work)
            for access in accesses if store else ():
                keep(access)
            said = f"{sum(counts)} objects written and read back" if any(counts) else "nothing to write"
            operator.say(f"arm {arm.name}: {said}{'; stored' if store else ''}")
        done += nodes
    return done


def _refuse_values_of_runs(context: CellContext, connected: Nodes) -> None:
    """Refuse to store the parameters of a drive that still holds a value written by a run of the gateway.

    A drive stores all its parameters at once. Values of an earlier `config apply` are the engineer's own.
    """
    for drive in connected.drives:
        entries = [entry for entry in drive.access.noted if entry.writer != "applied"]
        if entries:
            more = f" and {len(entries) - 1} more objects" if len(entries) > 1 else ""
            raise PlanRefused(
                f"--store: {entries[0].where}{more} hold values of a run (write ledger), which the drive would keep for"
                f" ever; nothing was written to the drives of this arm; type `servo-gateway restore {context.path}`"
                " first, then `config apply --store`"
            )


# ------------------------------------------------------------------------------------------------------- restoring


def restore(
    context: CellContext,
    *,
    same_drive: Callable[[str], bool] = lambda _question: False,
    forget: Callable[[dict[str, Any]], bool] = lambda _restored: False,
) -> tuple[list[dict[str, Any]], list[DriveError]]:
    """Disable drives that are still energised, then restore the parameters recorded in the write ledger.

    If a drive does not answer or refuses an object, the others are still restored.

    Parameters
    ----------
    context : CellContext
    same_drive : callable
        Called with a question where a drive without serial number may be one that was written over another bus.
    forget : callable
        Called with what was done to the drives of an arm; returns whether entries that are left are removed from the
        ledger.

    Returns
    -------
    arms : list of dict
        Of each arm its name (`arm`). Objects that were `put_back`, that were `written_by_others` since and keep their
        values, and that are `left` in the ledger. The drives that were `disabled`, as sentences.
    failures : list of DriveError
        Why objects are left, and which drives did not answer.
    """
    arms: list[dict[str, Any]] = []
    failures: list[DriveError] = []
    for arm in context.arms:
        with context.connected_for_restore(arm) as nodes:
            for node in nodes.all:
                elsewhere = nodes.ledger.of_other_bus(node.access.device)
                where = " and ".join(sorted({str(entry.bus) for entry in elsewhere}))
                if elsewhere and same_drive(
                    f"Node {node.node_id} has no serial number, and the write ledger holds {len(elsewhere)} objects of"
                    f" a drive like it that were written over {where}. Is this the same drive?"
                ):
                    node.access.take_over(elsewhere)
            before, wrong = nodes.noted, list(nodes.failures_found)
            if nodes.all:
                try:
                    nodes.restore()
                except DriveError as error:
                    wrong.append(error)
            others, left = [entry for node in nodes.all for entry in node.access.superseded], nodes.noted
            back = [entry for entry in before if entry not in left and entry not in others]
            listed = {"put_back": back, "written_by_others": others, "left": left}
            restored: dict[str, Any] = {key: [str(entry) for entry in entries] for key, entries in listed.items()}
            restored |= {"arm": arm.name, "disabled": list(nodes.taken_down)}
            if forget(restored) and left:
                nodes.ledger.forget(*left)
                restored["left"], wrong = [], []
        arms.append(restored)
        failures += wrong
    return arms, failures
