"""Read drives and their files; nothing is written to a drive."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from drives.bus import Bus, BusSpec, open_bus
from drives.datasheet.building import read_sheet
from drives.datasheet.sheet import Sheet
from drives.discovery import matching_profiles, scan
from drives.errors import BusError, SdoAbort
from drives.sdo import SdoClient
from drives.values import Identity
from gateway.newcell.answers import ASSUMED
from gateway.newcell.nodes import Address, Read, SeenNode

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
