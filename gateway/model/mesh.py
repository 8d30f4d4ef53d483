"""Vertices of a mesh file, all that a hull around it needs: STL (binary and text) and OBJ."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

MOST_BYTES = 200_000_000
_HEAD = 84
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_PACKAGE, _FILE = "package://", "file://"
#: Keyword of a vertex in the text formats.
_WORDS = {".stl": "vertex", ".obj": "v"}


class MeshError(ValueError):
    """A mesh whose vertices are not to be had; the message says why, in a few words."""


def find_mesh(name: str, source: str) -> Path:
    """Path of a mesh as a URDF names it, from the folder of the URDF on.

    `package://NAME/..` is looked for in a folder NAME above the URDF, or beside one of the folders above it, as ROS
    packages lie.

    Parameters
    ----------
    name : str
    source : str
        Path of the URDF.
    """
    folder = Path(source).resolve().parent
    if name.startswith(_FILE):
        return Path(name.removeprefix(_FILE))
    if not name.startswith(_PACKAGE):
        return folder / name
    package, _, rest = name.removeprefix(_PACKAGE).partition("/")
    for above in (folder, *folder.parents):
        for root in (above, above / package):
            if root.name == package and (root / rest).is_file():
                return root / rest
    return folder / rest


def read_vertices(path: Path) -> Floats:
    """Vertices (n, 3) of a mesh, in the unit of the file.

    Raises
    ------
    MeshError
        The file cannot be read, is of another format, or has no finite vertices.
    """
    kind = path.suffix.lower()
    if kind not in _WORDS:
        raise MeshError(f"{path.name} is neither STL nor OBJ")
    try:
        if path.stat().st_size > MOST_BYTES:
            raise MeshError(f"{path.name} is larger than {MOST_BYTES // 1_000_000} MB")
        data = path.read_bytes()
    except OSError as error:
        raise MeshError(f"{path.name} cannot be read: {error.strerror}") from error
    count = int.from_bytes(data[_HEAD - 4 : _HEAD], "little")
    if kind == ".stl" and len(data) == _HEAD + count * _TRIANGLE.itemsize:
        points = np.frombuffer(data, _TRIANGLE, count, _HEAD)["corners"].reshape(-1, 3).astype(float)
    else:
        points = _from_text(data, _WORDS[kind], path.name)
    if not len(points) or not np.isfinite(points).all():
        raise MeshError(f"{path.name} has no vertices, or some that are no numbers")
    return points


def _from_text(data: bytes, word: str, name: str) -> Floats:
    rows = [line.split() for line in data.decode("ascii", "replace").splitlines()]
    try:
        return np.array([[float(value) for value in row[1:4]] for row in rows if row and row[0] == word]).reshape(-1, 3)
    except ValueError as error:
        raise MeshError(f"{name} has a vertex that is no three numbers") from error
