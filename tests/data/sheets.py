"""Data sheets of simulated drives as their maker would deliver them: EDS of the type, DCF of each device."""

from __future__ import annotations

import warnings
from pathlib import Path

from canopen.objectdictionary import export_od

from drives.objects import OBJECTS
from sim.fake_drive import FakeDrive

OBJECTS_BY_ADDRESS = {entry.address: entry.name.replace("_", " ") for entry in OBJECTS.values()}


def write_sheet(drive: FakeDrive, path: Path) -> Path:
    """EDS or DCF, by the name of the file; a DCF holds what the drive holds, and its node id."""
    dictionary = drive.store.dictionary()
    about = dictionary.device_information
    about.vendor_name, about.product_name = "a maker", "a drive"
    about.vendor_number, about.product_number = (drive.store.number((0x1018, sub)) for sub in (1, 2))
    about.revision_number = drive.store.number((0x1018, 3))
    dictionary.node_id = drive.node_id
    for index in list(dictionary):
        if drive.node.sdo.refuse(index, 0):
            del dictionary[index]
    for index, thing in dictionary.items():
        for variable in [thing] if not hasattr(thing, "values") else thing.values():
            value = drive.store.find(index, variable.subindex).get()
            known = OBJECTS_BY_ADDRESS.get((index, variable.subindex))
            variable.name = known or variable.name
            if isinstance(value, int):  # a number below zero as its two's complement, as tools write it
                bits = 8 * drive.store.find(index, variable.subindex).size_bytes
                variable.value_raw = f"0x{value % (1 << bits):X}"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        export_od(dictionary, str(path))
    return path
