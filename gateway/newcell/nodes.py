"""Data of drives or their device files: read without writing, values with their source, and derived values."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from drives.bus import Bus, BusSpec, open_bus
from drives.datasheet.building import read_sheet
from drives.datasheet.sheet import Sheet
from drives.discovery import matching_profiles, scan
from drives.errors import BusError, SdoAbort
from drives.objects import OBJECTS
from drives.profile import DriveProfile, ObjectReference
from drives.sdo import SdoClient
from drives.values import Identity
from gateway.newcell.answers import ASSUMED

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
        found |= {(entry.index, entry.subindex): entry.type for entry in profile.constant_objects}
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


_DRIVE = 0x0192


class BusEyes:
    """Reader of drives on a bus and of their files; nothing is written.

    Parameters
    ----------
    listen_s : float
        Time limit for an answer [s].
    reserve : callable
        Called with a bus before it is opened.
    """

    def __init__(self, listen_s: float, reserve: Callable[[BusSpec], None] = lambda _spec: None) -> None:
        self._listen_s, self._reserve = listen_s, reserve

    def nodes(self, spec: BusSpec) -> tuple[SeenNode, ...]:
        """Drives on a bus."""
        self._reserve(spec)
        with open_bus(spec) as bus:
            found = nodes_on(bus, self._listen_s)
        if not found:
            advice = "check power, wiring and bit rate; without a bus write offline = true, or --offline"
            raise BusError(f"{spec}: no drive answered", advice=advice)
        return found

    def values(self, spec: BusSpec, wanted: Mapping[int, Mapping[Address, str]]) -> dict[int, dict[Address, Read]]:
        """Objects of some nodes."""
        self._reserve(spec)
        with open_bus(spec) as bus:
            return {node_id: values_of(bus, node_id, addresses) for node_id, addresses in wanted.items()}

    def files(self, paths: Sequence[Path]) -> tuple[SeenNode, ...]:
        """Devices of EDS and DCF files."""
        return nodes_in(paths)


def nodes_on(bus: Bus, listen_s: float) -> tuple[SeenNode, ...]:
    """Return the drives on a bus by node id; an id with two devices is omitted."""
    return tuple(
        SeenNode(found.identity.node_id, found.identity, {}, found.profiles, f"node {found.identity.node_id}")
        for found in scan(bus, listen_s=listen_s)
        if found.devices == 1 and found.identity.is_drive
    )


def values_of(bus: Bus, node_id: int, addresses: Mapping[Address, str]) -> dict[Address, Read]:
    """Return the objects of a node; missing ones are omitted.

    Raises
    ------
    SdoError
        The node does not answer or violates the protocol.
    """
    sdo, found = SdoClient(bus, node_id), dict[Address, Read]()
    try:
        for (index, subindex), kind in addresses.items():
            try:
                value = sdo.read(index, subindex, kind)
            except SdoAbort:
                continue
            found[index, subindex] = Read(value, f"read from drive, 0x{index:04X}")
    finally:
        sdo.close()
    return found


def nodes_in(files: Sequence[Path]) -> tuple[SeenNode, ...]:
    """Return the devices of EDS and DCF files, in file order.

    Raises
    ------
    ProfileError
        A file cannot be read or is not a data sheet.
    """
    return tuple(_node_in(path, read_sheet(path)) for path in files)


def _node_in(path: Path, sheet: Sheet) -> SeenNode:
    kind = sheet.value_of(0x1000)
    identity = Identity(
        node_id=sheet.node_id or 0,
        device_type=_DRIVE if kind is None else kind,
        vendor_id=sheet.vendor_id,
        product_code=sheet.product_code,
        revision=sheet.revision,
        serial_number=None,
        name=sheet.product_name or None,
        hardware_version=None,
        software_version=None,
    )
    values: dict[Address, Read] = {}
    for address, entry in sheet.entries.items():
        for text, origin in ((entry.value, "read from"), (entry.default, f"{ASSUMED}: default of")):
            value = None if sheet.type_of(*address) is None else sheet.number(entry, text)
            if value is not None:
                values[address] = Read(value, f"{origin} {path.name}, 0x{address[0]:04X}")
                break
    return SeenNode(sheet.node_id, identity, values, matching_profiles(identity), path.name, sheet)
