"""Write a configuration file's values to drives at rest: what differs, entered before, read back after, or undone."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Final

from drives.access import NodeAccess, ObjectAccess
from drives.bringup import refuse_enabled
from drives.configuration.dcf import NodeConfiguration
from drives.configuration.difference import Compared, Readout, differing
from drives.configuration.kinds import confirmation_reason, is_mapping, why_never_written
from drives.datasheet.object_values import Value, ledger_value
from drives.errors import ConfigurationRefused, DriveError, raise_failures
from drives.heartbeat import NmtCommand, send_nmt
from drives.ledger import LedgerEntry
from drives.objects import OBJECTS, object_name
from drives.pdo import Step, ordered_steps
from drives.profile import DriveProfile
from drives.sdo import SLOW

Address = tuple[int, int]
#: "save", as 0x1010 takes it (CiA 301, 7.5.2.13).
SAVE: Final = 0x65766173
#: Lower and upper limit of one thing: a drive takes no lower one above the upper one (CiA 402-2).
_PAIRS: Final = frozenset({0x607B, 0x607D})


@dataclass(frozen=True, slots=True)
class NodeWrites:
    """What is written to one drive, in this order."""

    access: ObjectAccess
    steps: tuple[Step, ...]


def questions(file: NodeConfiguration, rows: Sequence[Compared], nodes: Collection[int]) -> list[tuple[Compared, str]]:
    """Rows that differ and are written only if a question of their own was answered, with the reason.

    Parameters
    ----------
    file : NodeConfiguration
    rows : sequence of Compared
    nodes : collection of int
        Every node of the bus.
    """
    entries, others = file.sheet.entries, set(nodes) - {file.node_id}
    asked = [(row, confirmation_reason(entries[row.address], row.file, others)) for row in differing(rows)]
    return [(row, why) for row, why in asked if why is not None]


def planned_writes(
    access: ObjectAccess,
    file: NodeConfiguration,
    found: Readout,
    rows: Sequence[Compared],
    left_out: Collection[Address] = (),
) -> NodeWrites:
    """Return the writes that bring a drive to the values of its file, except the objects left out.

    Raises
    ------
    ConfigurationRefused, SeveralFailures
        Objects that the drive lacks, that are never written, or of a type that the ledger cannot hold; all at once.
    """
    changed = [row for row in differing(rows) if row.address not in left_out]
    raise_failures([problem for row in changed if (problem := _obstacle(access, access.profile, row)) is not None])
    wanted = {row.address: row.file for row in changed}
    stated = {address: value for address, value in file.values.items() if address not in left_out}
    wanted |= _whole_records(wanted, {**found.values, **stated})
    values: dict[Address, tuple[str, int]] = {}
    for address in _limits_in_order(sorted(wanted), wanted, found):
        word = ledger_value(file.sheet.entries[address].data_type, wanted[address])
        if word is not None:
            values[address] = word
    work = NodeWrites(access, tuple(ordered_steps(values, f"config apply: {file.path.name}")))
    raise_failures(_of_runs(work))
    return work


def _of_runs(work: NodeWrites) -> list[DriveError]:
    """Return an error for objects that a run wrote and `restore` has not restored: their original value would be
    lost.
    """
    wanted = {(step.index, step.subindex) for step in work.steps}
    found = [entry for entry in work.access.noted if entry.writer == "run" and entry.address in wanted]
    if not found:
        return []
    named = ", ".join(object_name(*entry.address) for entry in found[:6])
    more = f" and {len(found) - 6} more" if len(found) > 6 else ""
    return [
        ConfigurationRefused(
            f"a run of the gateway wrote {named}{more}, and that is not put back yet",
            node=work.access.node_id,
            advice="type `servo-gateway restore CELL` first, then `config apply`",
        )
    ]


def _obstacle(access: NodeAccess, profile: DriveProfile, row: Compared) -> ConfigurationRefused | None:
    why = why_never_written(row.address, profile)
    advice = "take it out of the file, or set it with the maker's own tool"
    if row.state == "not on drive":
        why, advice = f"the drive does not give it: {row.why}", "take it out of the file; another firmware may lack it"
    elif why is None and ledger_value(row.data_type, row.file) is None:
        why = "the write ledger cannot hold its type"
    if why is None:
        return None
    return ConfigurationRefused(
        f"is not written: {why}", node=access.node_id, index=row.index, subindex=row.subindex, advice=advice
    )


def _whole_records(wanted: dict[Address, Value], there: dict[Address, Value]) -> dict[Address, Value]:
    """What is written besides of PDOs: identifier, and of a mapping its length and every entry, from file or drive."""
    more: dict[Address, Value] = {}
    for index in {address[0] for address in wanted if 0x1400 <= address[0] < 0x1C00}:
        head = (index & ~0x0200, 1)
        if head in there:
            more[head] = there[head]
        if is_mapping((index, 0)):
            count = there.get((index, 0), 0)
            used = count if isinstance(count, int) else 0
            more |= {(index, sub): there[index, sub] for sub in range(used + 1) if (index, sub) in there}
    return more


def _limits_in_order(order: list[Address], wanted: dict[Address, Value], found: Readout) -> list[Address]:
    """The upper limit of a pair before the lower one where the new lower one is above the old upper one."""
    for index in _PAIRS & {address[0] for address in order}:
        low, high = (index, 1), (index, 2)
        new, old = wanted.get(low), found.values.get(high)
        if high in wanted and isinstance(new, int) and isinstance(old, int) and new > old:
            order.remove(high)
            order.insert(order.index(low), high)
    return order


def require_at_rest(accesses: Sequence[ObjectAccess]) -> None:
    """See that no drive of an arm is enabled.

    Raises
    ------
    DriveFault
    """
    for access in accesses:
        refuse_enabled(access)


def write_all(work: Sequence[NodeWrites]) -> None:
    """Write to several drives; at the first failure everything that was written is put back.

    The drives are taken to PRE-OPERATIONAL, where records of PDOs may be written. Once all is written, the values are
    the engineer's: the next run takes them for the original (`NodeAccess.adopt_applied`).

    Raises
    ------
    ConfigurationRefused, SeveralFailures
        A run wrote one of the objects and it is not restored; nothing is written.
    DriveError
        The first failure; a note lists what was restored and what was not.
    """
    raise_failures([failure for each in work for failure in _of_runs(each)])
    done: list[tuple[NodeAccess, dict[Address, tuple[str, int]], tuple[LedgerEntry, ...]]] = []
    try:
        for each in work:
            access = each.access
            if each.steps:
                send_nmt(access.bus, NmtCommand.ENTER_PREOPERATIONAL, access.node_id)
            noted, old = access.noted, dict[Address, tuple[str, int]]()
            done.append((access, old, noted))
            held = access.note_steps(each.steps, "applying")
            for step in each.steps:
                old.setdefault((step.index, step.subindex), held[step.index, step.subindex])
                access.write_step(step)
    except BaseException as error:
        left = [name for access, old, noted in reversed(done) for name in access.undo(old, noted)]
        error.add_note(
            f"{', '.join(left)} could not be restored and stays in the write ledger: run `restore` again"
            if left
            else "what had been written is put back"
        )
        raise
    if work:
        work[0].access.finish_applying([each.access.device for each in work])


def store(access: ObjectAccess) -> None:
    """Have a drive keep all its parameters for the next power-up (0x1010:01).

    Raises
    ------
    SdoError
        It refuses, or takes longer than the profile's slow time-out.
    """
    entry = OBJECTS["store_parameters"]
    access.sdo.write(entry.index, entry.subindex, entry.type, SAVE, SLOW)
