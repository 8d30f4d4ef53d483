"""Known loads, and stored identifications of the unloaded arm."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.data.labels import BARE_LABEL, label_refused
from gateway.errors import DataUnusable, InputError
from gateway.identify.links import PER_LINK_AT_REST
from gateway.identify.nuisance import beyond_warm, change_covariance
from gateway.result.result import Bare

Floats = NDArray[np.float64]

#: Names of the load parameters, and their units.
LOAD_NAMES: Final = ("mass", "hx", "hy", "hz")
LOAD_UNITS: Final = ("kg", "kg m", "kg m", "kg m")
#: Smallest standard deviation of a stored identification, as a share of its largest.
_SUREST: Final = 1e-12
#: Least standard deviation [kg, kg m]: rows with more weight would hide the measured ones by rounding.
_EXACT_KG: Final = 1e-10
#: Range of every joint angle [rad] within which the visits of a load count as one posture: 3 degrees barely turn
#: gravity.
_ONE_POSTURE_RAD: Final = 0.05


def unknown_labels(present: Iterable[str], known: Mapping[str, object]) -> tuple[str, ...]:
    """Return the labels of the loads to estimate, in the order of the rows.

    Raises
    ------
    InputError
        A known load that no row carries.
    """
    labels = refuse_absent(present, known)
    return tuple(label for label in labels if label != BARE_LABEL and label not in known)


def refuse_absent(present: Iterable[str], known: Iterable[str], files: Iterable[str] = ()) -> tuple[str, ...]:
    """Return the labels of the rows in their order, each once; refuse a known label that is absent from the files.

    Raises
    ------
    InputError
        A known load that no row carries.
    """
    labels = tuple(dict.fromkeys(str(label) for label in present))
    for label in known:
        if label not in labels:
            raise InputError(f"--known {label}: no row carries this load; {_held(labels, files)}")
    return labels


def _held(labels: Iterable[str], files: Iterable[str]) -> str:
    """Return the loads of the data, and the names of its files."""
    names = ", ".join(dict.fromkeys(files))
    return f"the data{names and f' ({names})'} hold {', '.join(labels)}"


def refuse_parts(
    present: Iterable[str], parts: Mapping[str, tuple[str, str]], known: Mapping[str, object], files: Iterable[str]
) -> None:
    """Refuse a part that is not the difference of two loads of the rows, of which one is to be estimated.

    Raises
    ------
    InputError
    """
    labels = tuple(dict.fromkeys(str(label) for label in present))
    for name, pair in parts.items():
        if len(set(pair)) < 2:
            raise InputError(f"--part {name}: '{pair[0]}' is named twice; name the gripper with the part, then alone")
        for label in (name, *pair):
            wrong = "is the unloaded arm: --part takes loads" if label == BARE_LABEL else label_refused(label)
            if wrong:
                raise InputError(f"--part {name}: '{label}' {wrong}")
        for label in pair:
            if label not in labels:
                raise InputError(f"--part {name}: no row carries '{label}'; {_held(labels, files)}")
        if name in labels:
            raise InputError(f"--part {name}: the data hold a load of this label; choose another name for the part")
        if set(pair) <= known.keys():
            raise InputError(f"--part {name}: both loads are known exactly; take one of them out of --known")


def load_functions(
    first: Mapping[str, int],
    known: Mapping[str, Floats],
    parts: Mapping[str, tuple[str, str]],
    shape: tuple[int, int],
) -> dict[str, tuple[Floats, Floats]]:
    """Return by label the linear function (k, p) of the parameters and the constant (k,) whose sum is [m, h, ..].

    Loads to estimate come first, then parts, each the difference of two loads; a part of an absent load is left out.

    Parameters
    ----------
    first : first column of each load to estimate
    known : parameters of each load that is known exactly
    parts : as of `Knowledge`
    shape : (k, p)
    """
    size, count = shape
    loads = {label: (np.zeros(shape), vector) for label, vector in known.items()}
    loads |= {label: (np.eye(size, count, column), np.zeros(size)) for label, column in first.items()}
    out = {label: loads[label] for label in first}
    for name, (both, gripper) in parts.items():
        if both in loads and gripper in loads:
            out[name] = (loads[both][0] - loads[gripper][0], loads[both][1] - loads[gripper][1])
    return out


def require_postures(q_rad: Floats, label: str) -> None:
    """Refuse a load that was measured in a single posture, from the joint angles (n, N) of its visits.

    Raises
    ------
    DataUnusable
    """
    if len(q_rad) and np.ptp(q_rad, axis=0).max() < _ONE_POSTURE_RAD:
        raise DataUnusable(
            f"load '{label}' was measured in one posture: its rows have rank 3, because the part of the centre of mass"
            " along gravity turns no axis; add at least one posture in which gravity comes from another side of the"
            " flange (more than 30 degrees apart), ten are better"
        )


def load_vector(known: Sequence[float]) -> Floats:
    """[m, h] (4,) of mass [kg] and centre of mass [m]."""
    mass, *com = known
    return mass * np.array([1.0, *com])


def bare_rows(bare: Bare, change: float = 1.0) -> tuple[Floats, Floats]:
    """Return a stored identification of the unloaded arm as rows (k, 6 N) and right side (k,) with unit standard
    deviation.

    Columns are the 4 N link parameters, the gains and the friction biases of that fit. They are the same under a load.
    The rows stand for the prior of those gains and biases too; a column is 0 where none is stored. Both fits have the
    change of gain on each of their occasions. `change` is the factor on it: an arm that is warm on two days also
    changes from one to the other.
    """
    combination, value = np.asarray(bare.combination, dtype=float), np.asarray(bare.value, dtype=float)
    rank, links = combination.shape
    axes = links // PER_LINK_AT_REST
    further = _stored(bare)
    covariance = np.array(bare.gain_covariance if bare.gain else bare.covariance, dtype=float)
    gains = slice(rank, min(rank + axes, len(covariance)))
    covariance[gains, gains] += change_covariance(gains.stop - rank, beyond_warm(change))
    stored = np.flatnonzero(np.isfinite(further[: len(covariance) - rank]))
    rows = np.zeros((rank + len(stored), links + 2 * axes))
    rows[:rank, :links] = combination
    rows[rank + np.arange(len(stored)), links + stored] = 1.0
    both = np.concatenate([np.arange(rank), rank + stored])
    right = np.concatenate([value, further[stored]])
    size, vectors = np.linalg.eigh(covariance[np.ix_(both, both)])
    size = np.maximum(size, max(_SUREST * float(size.max(initial=0.0)), _EXACT_KG**2))
    whiten = (vectors / np.sqrt(size)).T
    return whiten @ rows, whiten @ right


def stored_errors(bare: Bare) -> NDArray[np.bool_]:
    """Mask (2 N,) of the gains and friction biases that a stored identification contains."""
    held = len(bare.gain_covariance if bare.gain else bare.covariance) - len(bare.value)
    return np.isfinite(_stored(bare)) & (np.arange(2 * len(bare.offset_nm)) < held)


def _stored(bare: Bare) -> Floats:
    """Gains and friction biases (2 N,) of a stored identification; NaN where none is stored."""
    return np.concatenate(
        [np.resize(bare.gain or np.nan, len(bare.offset_nm)), np.asarray(bare.offset_nm, dtype=float)]
    )
