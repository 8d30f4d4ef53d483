"""Loads that are known, and a bare arm that was identified before."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.errors import InputError
from gateway.result.result import Bare

Floats = NDArray[np.float64]

#: Label of rows without a load.
BARE_LABEL: Final = "none"
#: What a stored identification knows better than this share of what it knows least, it knows that well.
_SUREST: Final = 1e-12


def unknown_labels(present: Iterable[str], known: Mapping[str, object]) -> tuple[str, ...]:
    """Loads to estimate, in the order they appear.

    Raises
    ------
    InputError
        A known load that no row carries.
    """
    labels = tuple(dict.fromkeys(str(label) for label in present))
    for label in known:
        if label not in labels:
            raise InputError(f"--known {label}: no row carries this load; the data hold {', '.join(labels)}")
    return tuple(label for label in labels if label != BARE_LABEL and label not in known)


def load_vector(known: Sequence[float]) -> Floats:
    """[m, h] (4,) of mass [kg] and centre of mass [m]."""
    mass, *com = known
    return mass * np.array([1.0, *com])


def bare_rows(bare: Bare) -> tuple[Floats, Floats]:
    """A stored bare identification as rows (k, 4 N) and right side (k,) with unit standard deviation."""
    combination, value = np.asarray(bare.combination, dtype=float), np.asarray(bare.value, dtype=float)
    size, vectors = np.linalg.eigh(np.asarray(bare.covariance, dtype=float))
    size = np.maximum(size, max(_SUREST * float(size.max(initial=0.0)), 1e-28))
    whiten = (vectors / np.sqrt(size)).T
    return whiten @ combination, whiten @ value
