"""Bus of each arm: from the cell, or from the command line."""

from __future__ import annotations

from drives.bus import BusSpec
from gateway.cell.config import Cell
from gateway.errors import ConfigError


def bus_specs(cell: Cell, stated: str | None) -> dict[str, BusSpec]:
    """Return the bus of every name in the cell, with the overrides of the command line.

    Parameters
    ----------
    cell : Cell
    stated : str or None
        A SPEC if the cell has one bus; NAME=SPEC;NAME=SPEC for several; the others are those of the cell.

    Raises
    ------
    ConfigError
        A single SPEC for several buses, or a bus that the cell does not have, or one twice, or two names for one bus.
    BusError
        A SPEC is not understood.
    """
    specs = {name: config.spec for name, config in cell.bus.items()}
    if stated is None:
        return specs
    specs |= _stated(stated, tuple(cell.bus))
    wires: dict[str, str] = {}
    for name, spec in specs.items():
        other = wires.setdefault(spec.wire, name)
        if other != name:
            raise ConfigError(
                f"--bus '{stated}': buses '{other}' and '{name}' are both {spec.wire}: one bus has one master; give"
                " each its own bus"
            )
    return specs


def _stated(stated: str, names: tuple[str, ...]) -> dict[str, BusSpec]:
    form = f"give NAME=SPEC;NAME=SPEC with {', '.join(names)}"
    found: dict[str, BusSpec] = {}
    for part in stated.split(";"):
        name, equals, text = part.partition("=")
        # an option of a SPEC has its equals sign after INTERFACE:CHANNEL, a bus has a name without colon
        if not equals or ":" in name:
            if len(names) != 1 or ";" in stated:
                raise ConfigError(f"--bus '{part}': the cell has {len(names)} buses, and no bus is named; {form}")
            return {names[0]: BusSpec.parse(stated)}
        if name.strip() not in names:
            raise ConfigError(f"--bus '{part}': the cell has no bus '{name.strip()}'; {form}")
        if name.strip() in found:
            raise ConfigError(f"--bus: bus '{name.strip()}' is given twice; {form}")
        found[name.strip()] = BusSpec.parse(text.strip())
    return found
