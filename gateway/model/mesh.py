"""Compute the corners of a convex body around a mesh file: STL (binary and text) and OBJ, regular files of limited
size.
"""

from __future__ import annotations

import io
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from gateway.data.regular_file import read_bounded

Floats = NDArray[np.float64]

#: Largest file size: a binary STL file of a million triangles.
MOST_BYTES: Final = 50_000_000
MOST_VERTICES: Final = 3_000_000
#: A hull with at most this many corners is kept; a larger one is replaced by a simpler body around it.
MOST_CORNERS: Final = 256
#: Number of vertices per hull computation, and rows per matrix product.
_AT_ONCE: Final = 20_000
_HEAD = 84
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_PACKAGE, _FILE = "package://", "file://"
#: Keyword of a vertex in the text formats.
_WORDS = {".stl": "vertex", ".obj": "v"}


class MeshError(ValueError):
    """Vertices of a mesh cannot be read; the message states the reason."""


def find_mesh(name: str, source: str) -> Path:
    """Return the path of a mesh named in a URDF, relative to the folder of the URDF.

    `package://NAME/..` is searched in a folder NAME above the URDF, or beside one of the folders above it, as ROS
    packages are stored.

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


def mesh_corners(path: Path) -> Floats:
    """Return corners (n, 3) of a convex body that contains a mesh, in the unit of the file.

    Raises
    ------
    MeshError
        See `read_vertices`.
    """
    try:
        status = path.stat()
    except OSError as error:
        raise MeshError(f"{path.name} cannot be read: {error.strerror}") from error
    return _mesh_corners(path, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=64)
def _mesh_corners(path: Path, _changed_ns: int, _bytes: int) -> Floats:
    return simple_corners(read_vertices(path))


def simple_corners(points: Floats) -> Floats:
    """Return at most `MOST_CORNERS` corners (n, 3) whose convex hull contains all points (m, 3).

    The farthest points in many directions span a body inside the hull. It is enlarged about its centre, by about 4 %,
    until it contains all points.
    """
    if len(points) <= _AT_ONCE:
        try:
            hull = ConvexHull(points).vertices
        except (QhullError, ValueError):  # flat or few
            return points if len(points) <= MOST_CORNERS else _box_around(points)
        if len(hull) <= MOST_CORNERS:
            return points[hull]
        points = points[hull]
    middle = points.mean(axis=0)
    spread = points - middle
    axes = np.linalg.eigh(spread.T @ spread)[1]
    extent = np.abs(spread @ axes).max(axis=0)
    if extent.min() <= 1e-9 * extent.max():
        return _box_around(points)
    spread = spread @ axes / extent  # as long as it is wide: all directions have equal weight
    chosen = spread[np.unique(_farthest(spread))]
    hull = ConvexHull(chosen)
    corners, normals = chosen[hull.vertices], hull.equations[:, :3]
    inside = corners.mean(axis=0)
    outward = (normals / -(normals @ inside + hull.equations[:, 3])[:, None]).T  # 1 on each face
    beyond = max(float(((part - inside) @ outward).max()) for part in _parts(spread))
    enlarged = inside + max(beyond, 1.0) * (1.0 + 1e-12) * (corners - inside)
    return middle + enlarged * extent @ axes.T


def _farthest(points: Floats) -> NDArray[np.intp]:
    """Return the index of the farthest point in each direction."""
    # Unit vectors (n, 3) evenly distributed on a sphere (a Fibonacci lattice), and those of the axes
    count = MOST_CORNERS // 2 - 6
    height = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    angle = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(count)
    wide = np.sqrt(1.0 - height**2)
    directions = np.vstack(
        [np.column_stack([wide * np.cos(angle), wide * np.sin(angle), height]), np.eye(3), -np.eye(3)]
    )
    best, row = np.full(len(directions), -np.inf), np.zeros(len(directions), dtype=np.intp)
    for number, part in enumerate(_parts(points)):
        along = part @ directions.T
        ahead = along.argmax(axis=0)
        value = along[ahead, np.arange(len(directions))]
        further = value > best
        best[further], row[further] = value[further], ahead[further] + number * _AT_ONCE
    return row


def _parts(points: Floats) -> list[Floats]:
    return [points[first : first + _AT_ONCE] for first in range(0, len(points), _AT_ONCE)]


def _box_around(points: Floats) -> Floats:
    """Return the corners (8, 3) of the box along the principal axes that contains coplanar points."""
    middle = points.mean(axis=0)
    axes = np.linalg.eigh((points - middle).T @ (points - middle))[1]
    along = (points - middle) @ axes
    ends = np.stack([along.min(axis=0), along.max(axis=0)])
    return (
        middle
        + np.array([[ends[i, 0], ends[j, 1], ends[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]) @ axes.T
    )


def read_vertices(path: Path) -> Floats:
    """Read the vertices (n, 3) of a mesh, in the unit of the file.

    Raises
    ------
    MeshError
        The file cannot be read, is not a regular file, is too large, is of another format, or has no finite vertices.
    """
    kind = path.suffix.lower()
    if kind not in _WORDS:
        raise MeshError(f"{path.name} is not an STL or OBJ file")
    try:
        data = read_bounded(path, MOST_BYTES)
    except OSError as error:
        raise MeshError(f"{path.name} cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise MeshError(f"{path.name} is not used: {error}") from error
    count = int.from_bytes(data[_HEAD - 4 : _HEAD], "little")
    if kind == ".stl" and len(data) == _HEAD + count * _TRIANGLE.itemsize:
        points = np.frombuffer(data, _TRIANGLE, count, _HEAD)["corners"].reshape(-1, 3).astype(float)
    else:
        rows = (line.split() for line in io.BytesIO(data))
        vertices = (row[1:4] for row in rows if row and row[0] == _WORDS[kind].encode())
        parts = [np.empty((0, 3))]
        try:
            while part := list(islice(vertices, _AT_ONCE)):
                parts.append(np.array([[float(value) for value in row] for row in part]).reshape(-1, 3))
                if len(parts) * _AT_ONCE > MOST_VERTICES:
                    raise MeshError(f"{path.name} is not used: it has more than {MOST_VERTICES} vertices")
        except ValueError as error:
            if isinstance(error, MeshError):
                raise
            raise MeshError(f"{path.name} has a vertex that is not three numbers") from error
        points = np.vstack(parts)
    if not len(points) or not np.isfinite(points).all():
        raise MeshError(f"{path.name} has no vertices, or vertices that are not numbers")
    return points
