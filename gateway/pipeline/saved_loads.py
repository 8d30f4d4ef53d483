"""Save the loads of a result in the library of the robot, `gateway.result.library`."""

from __future__ import annotations

import math
import os
from pathlib import Path

from drives.files import write_sealed
from gateway.errors import InputError
from gateway.result.drawn import Drawn
from gateway.result.library import library_of, read_library
from gateway.result.origin import file_sha256
from gateway.result.result import Result
from gateway.result.values import plain_values


def save_loads(cell: Path, result: Result, file: Path) -> Path:
    """Write the loads of a result into the library beside the cell file, and return its path.

    An entry of the same label is replaced.

    Parameters
    ----------
    cell, file : Path
        Cell file, and the file of the result.
    result : Result

    Raises
    ------
    InputError
        The result holds no load with a mass, or the library was edited.
    """
    path, about = library_of(cell), result.data or Drawn()
    entries = read_library(path) if path.exists() else {}
    loads = [load for load in result.loads if math.isfinite(load.mass_kg)]
    if not loads:
        raise InputError(f"{path}: gets no load of this result. The result is in {file}")
    certificate, place = file.with_suffix(".xml"), os.path.relpath(file.resolve(), path.resolve().parent)
    origin = {"result": Path(place).as_posix(), "result_sha256": file_sha256(file), "arm": about.arm}
    origin |= {"certificate": certificate.name if certificate.is_file() else None, "created": about.created}
    bulky = {"per_pose_mass_kg", "budget", "common_errors"}  # the result file has them
    for load in loads:
        spread = plain_values(about.flange.get(load.label)) or {"com_std_m": None}
        known = {key: value for key, value in plain_values(load).items() if key not in bulky}
        further = {"com_flange_std_m": spread["com_std_m"], "drives": plain_values(about.drives)}
        entries[load.label] = known | further | origin
    write_sealed(path, {"schema": 1, "loads": entries})
    return path
