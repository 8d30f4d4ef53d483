"""Data of a drive or its device file: values with their source, and derived values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from drives.datasheet.sheet import Sheet
from drives.objects import OBJECTS
from drives.profile import Constant, DriveProfile, ObjectReference
from drives.values import Identity

Address = tuple[int, int]


@dataclass(frozen=True, slots=True)
class Read:
    """Value of an object and its source."""

    value: int
    source: str


@dataclass(frozen=True, slots=True)
class SeenNode:
    """One device.

    Attributes
    ----------
    node_id : int or None
        None = not stated in the file.
    identity : Identity
    values : mapping of (index, subindex) to Read
    profiles : tuple of str
        Matching built-in profiles, those of its manufacturer first.
    name : str
        Name in messages: `node 11`, `j1.eds`.
    sheet : Sheet or None
        Its EDS or DCF, if given.
    """

    node_id: int | None
    identity: Identity
    values: Mapping[Address, Read]
    profiles: tuple[str, ...]
    name: str
    sheet: Sheet | None = None

    def read(self, name: str) -> Read | None:
        """Return the value of a standard object."""
        return self.values.get(OBJECTS[name].address)

    def number(self, reference: ObjectReference) -> int | None:
        """Return the value of an object that a profile names; None if unknown."""
        read = self.values.get((reference.index, reference.subindex))
        return None if read is None else read.value


def of_axes(nodes: Sequence[int], on_bus: Sequence[SeenNode], in_files: Sequence[SeenNode]) -> list[SeenNode | None]:
    """Return the known data of the device of each axis; readings take precedence over files.

    A file belongs to an axis by its node id, else by its position in a list with one file per axis, else it is for all.
    """
    by_id = {node.node_id: node for node in on_bus}
    found: list[SeenNode | None] = []
    for axis, node_id in enumerate(nodes):
        live, sheet = by_id.get(node_id), _file_of(axis, node_id, len(nodes), in_files)
        if live is not None and sheet is not None:
            values = {**sheet.values, **live.values}
            found.append(replace(live, values=values, sheet=sheet.sheet))
        else:
            found.append(live or sheet)
    return found


def _file_of(axis: int, node_id: int, axes: int, in_files: Sequence[SeenNode]) -> SeenNode | None:
    stated = [sheet for sheet in in_files if sheet.node_id is not None]
    for sheet in stated:
        if sheet.node_id == node_id:
            return sheet
    if stated or not in_files:
        return None
    if len(in_files) == axes:
        return in_files[axis]
    return in_files[0] if len(in_files) == 1 else None


def addresses(profiles: Sequence[DriveProfile]) -> dict[Address, str]:
    """Return the objects to read, with their types: standard objects and those of profiles."""
    found = {OBJECTS[name].address: OBJECTS[name].type for name in STANDARD}
    for profile in profiles:
        for part in (profile.torque, profile.current, profile.torque_offset):
            rated = None if part is None else part.rated
            if rated is not None and rated.object is not None:
                found[rated.object.index, rated.object.subindex] = rated.object.type
        counts = profile.position.counts_per_revolution
        if not isinstance(counts, Constant):
            for entry in (counts.object, counts.per):
                if entry is not None:
                    found[entry.index, entry.subindex] = entry.type
    return found


STANDARD = (
    "rated_current",
    "rated_torque",
    "max_torque",
    "home_offset",
    "polarity",
    "position_limit_min",
    "position_limit_max",
    "max_motor_speed",
    "encoder_increments",
    "encoder_revolutions",
    "gear_motor_revolutions",
    "gear_shaft_revolutions",
)
