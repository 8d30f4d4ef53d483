"""Answers of a method: one JSON line per cell, read by the scorer. Any program can write this file."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Answer:
    """Answer of a method for one cell.

    Attributes
    ----------
    cell : folder name
    named : effects as (name, joints from 1); empty: none
    undecided : whether the effects are alternatives to each other instead of being present together
    load : of the load `tool` in the frame of the last link, or None: mass [kg], centre of gravity x, y, z [m]. A method
        may add Ixx, Iyy, Izz, Ixy, Ixz, Iyz [kg m^2] about the centre of gravity.
    load_std : their standard deviations, or None
    time_s : processor time of the method for this cell
    axes : parameters of the axes (N,) by quantity, if the method identifies any
    """

    cell: str
    named: tuple[tuple[str, tuple[int, ...]], ...]
    undecided: bool
    load: tuple[float, ...] | None
    load_std: tuple[float, ...] | None
    time_s: float
    axes: Mapping[str, tuple[float, ...]] = field(default_factory=dict)


def write_answers(answers: Iterable[Answer], file: Path) -> None:
    """Write one line per answer."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text("".join(json.dumps(asdict(each)) + "\n" for each in answers), encoding="utf-8")


def read_answers(file: Path) -> dict[str, Answer]:
    """Read the answers by cell."""
    found: dict[str, Answer] = {}
    for line in file.read_text(encoding="utf-8").splitlines():
        entry = json.loads(line)
        load, std = entry.get("load"), entry.get("load_std")
        found[entry["cell"]] = Answer(
            entry["cell"],
            tuple((str(name), tuple(int(joint) for joint in joints)) for name, joints in entry["named"]),
            bool(entry.get("undecided", False)),
            None if load is None else tuple(load),
            None if std is None else tuple(std),
            float(entry.get("time_s", "nan")),
            {name: tuple(values) for name, values in entry.get("axes", {}).items()},
        )
    return found
