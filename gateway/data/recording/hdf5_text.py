"""Typed access to HDF5 files of unknown origin: a value of the expected type, or `InputError` with its location.

libhdf5 reports damage by many types of exception, and a damaged header may claim any size. Sizes are compared with
the file before reading. Rejected: links and storage outside the file, and objects linked more than once.
"""

from __future__ import annotations

import importlib
import json
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from gateway.data.regular_file import regular_size
from gateway.errors import InputError

DAMAGE = (
    OSError,
    KeyError,
    ValueError,
    TypeError,
    RuntimeError,
    AttributeError,
    IndexError,
    OverflowError,
    MemoryError,
)

#: Low-level access to objects; h5py has no types for it.
_objects: Any = importlib.import_module("h5py.h5o")


@dataclass(frozen=True, slots=True)
class Hdf5Group:
    """Group of an open file, with its name for messages."""

    file: str
    limit_bytes: int
    group: h5py.Group

    def where(self, name: str = "") -> str:
        """Return `file:/group/name`."""
        return f"{self.file}:{self.group.name}{'/' if name else ''}{name}"

    def refuse(self, name: str, what: str) -> InputError:
        """Return an error about an object of this group."""
        return InputError(f"{self.where(name)}: {what}")

    def names(self) -> list[str]:
        """Return the names of the objects in the group."""
        return list(self.group.keys())

    def has(self, name: str) -> bool:
        """Return whether the group contains an object of that name."""
        return name in self.group

    def inside(self, name: str) -> Hdf5Group:
        """Return a subgroup."""
        found = self._object(name)
        if not isinstance(found, h5py.Group):
            raise self.refuse(name, "is not a group")
        return Hdf5Group(self.file, self.limit_bytes, found)

    def array(self, name: str, columns: int | None, kinds: str) -> np.ndarray:
        """Return a dataset of shape (n,) or (n, columns) and of number kinds `kinds` ("iu", "f").

        Raises
        ------
        InputError
            Missing, of another shape or kind, larger than the file.
        """
        found = self._dataset(name)
        dims = 1 if columns is None else 2
        if found.ndim != dims or (columns is not None and found.shape[1] != columns):
            raise self.refuse(
                name, f"has the shape {found.shape}, (n{'' if columns is None else f', {columns}'}) expected"
            )
        if found.dtype.kind not in kinds:
            raise self.refuse(name, f"holds {found.dtype}, numbers of another kind are expected")
        if found.nbytes > self.limit_bytes:
            raise self.refuse(name, f"claims {found.nbytes} bytes, more than the file has")
        return np.asarray(found[()])

    def columns(self, name: str, columns: int) -> np.ndarray:
        """Return a dataset of numbers of shape (n,) or (n, columns), with the errors of `array`."""
        return self.array(name, columns if self._dataset(name).ndim == 2 else None, "biuf")

    def attributes(self) -> dict[str, Any]:
        """Return all attributes as stored."""
        return {name: self._attribute(name, None) for name in self.group.attrs}

    def text(self, name: str, default: str | None = None) -> str:
        """Return a text attribute."""
        value = self._attribute(name, default)
        if isinstance(value, bytes):
            value = value.decode("utf-8")
        if not isinstance(value, str):
            raise self.refuse(f"@{name}", f"is {type(value).__name__}, text expected")
        return value

    def label(self, name: str) -> str:
        """Return a text attribute that is the label of a load."""
        value = self.text(name)
        if not value or not value.isprintable():
            raise self.refuse(
                f"@{name}", "is empty or contains control characters: the label of a load must be printable text"
            )
        return value

    def integer(self, name: str, default: int | None = None) -> int:
        """Return an integer attribute."""
        value = self._attribute(name, default)
        if not isinstance(value, int | np.integer | np.bool_):
            raise self.refuse(f"@{name}", f"is {type(value).__name__}, an integer expected")
        return int(value)

    def number(self, name: str) -> float:
        """Return an attribute that is a finite number."""
        value = self._attribute(name, None)
        if not isinstance(value, int | float | np.integer | np.floating) or not np.isfinite(value):
            raise self.refuse(f"@{name}", "is not a finite number")
        return float(value)

    def numbers(self, name: str, count: int, default: np.ndarray | None = None) -> np.ndarray:
        """Return an attribute of `count` finite numbers."""
        value = self._numbers(name, count, default)
        if not np.isfinite(value).all():
            raise self.refuse(f"@{name}", f"{count} finite numbers expected")
        return value

    def optional_numbers(self, name: str, count: int) -> np.ndarray | None:
        """Return an attribute of `count` numbers, NaN where one is missing; None if the attribute does not exist."""
        return self._numbers(name, count, None) if name in self.group.attrs else None

    def _numbers(self, name: str, count: int, default: np.ndarray | None) -> np.ndarray:
        value = np.asarray(self._attribute(name, default))
        if value.shape != (count,) or value.dtype.kind not in "iuf" or np.isinf(value).any():
            raise self.refuse(f"@{name}", f"{count} finite numbers expected")
        return value

    def document(self, name: str, kind: type, default: Any) -> Any:
        """Return a JSON attribute of type `kind`."""
        try:
            value = json.loads(self.text(name, json.dumps(default)))
        except (json.JSONDecodeError, RecursionError) as error:
            raise self.refuse(f"@{name}", f"is not JSON: {error}") from error
        if not isinstance(value, kind):
            raise self.refuse(f"@{name}", f"is {type(value).__name__}, {kind.__name__} expected")
        return value

    def _attribute(self, name: str, default: Any) -> Any:
        if name not in self.group.attrs:
            if default is None:
                raise self.refuse(f"@{name}", "is missing")
            return default
        kind = self.group.attrs.get_id(name)
        if int(np.prod(kind.shape, dtype=float)) * kind.dtype.itemsize > self.limit_bytes:
            raise self.refuse(f"@{name}", "claims more bytes than the file has")
        return self.group.attrs[name]

    def _dataset(self, name: str) -> h5py.Dataset:
        found = self._object(name)
        if not isinstance(found, h5py.Dataset):
            raise self.refuse(name, "is not a dataset")
        if found.is_virtual or found.external is not None:
            raise self.refuse(name, "stores its numbers in another file; a recording must contain all its data")
        return found

    def _object(self, name: str) -> Any:
        if name not in self.group:
            raise self.refuse(name, "is missing")
        if not isinstance(self.group.get(name, getlink=True), h5py.HardLink):
            raise self.refuse(name, "is a link out of the file")
        found = self.group[name]
        if _objects.get_info(found.id).rc != 1:
            raise self.refuse(name, "is linked more than once; a recording contains each group and dataset once")
        return found


@contextmanager
def open_recording(path: Path) -> Generator[Hdf5Group]:
    """Open an HDF5 file for reading; every error of libhdf5 becomes an `InputError`.

    Raises
    ------
    InputError
        The file is missing, not HDF5, truncated or damaged.
    """
    try:
        size = regular_size(path)
        with h5py.File(path, "r", locking=False) as file:
            yield Hdf5Group(str(path), size, file)
    except InputError:
        raise
    except DAMAGE as error:
        words = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"{path}: cannot be read as a recording, it is damaged or not HDF5 ({words})") from error
