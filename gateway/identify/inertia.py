"""Inertia of a load about its centre of gravity from ten fitted parameters, physically consistent.

The pseudo-inertia of a body, `J = [[S, h], [h', m]]` with the second moments of its mass `S = tr(I) / 2 E - I`, is
positive definite (Wensing et al. 2018). A free fit may violate this. Then the nearest body in the metric of the
covariance is returned. Its distance to the true body is at most that of the free fit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from gateway.result.inertia import COLUMN, ROW, tensor_of
from gateway.result.names import INERTIA_PARTS, INERTIA_WHOLE

Floats = NDArray[np.float64]

#: Index of each of `INERTIA_PARTS` among ten parameters [m, h, Ixx, Ixy, Ixz, Iyy, Iyz, Izz].
_MOMENTS = np.array([4, 7, 9, 5, 6, 8])
#: Least root of second moment over mass [m], as the thickness of a load.
_THINNEST_M: Final = 1e-3
#: Best uncertainty of a moment, as a radius of gyration [m].
_HAIR_M: Final = 5e-3
#: Largest standard deviation of a reported moment, over the largest principal moment.
_LARGEST_STD: Final = 0.5
#: The same as a radius of gyration [m], so that small moments are reported too.
_SMALL_M: Final = 0.05
_SAME: Final = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class LoadInertia:
    """Inertia of a load about its centre of gravity.

    Attributes
    ----------
    value_kg_m2, std_kg_m2 : arrays of shape (6,)
        As `INERTIA_PARTS`; NaN where not determined.
    free : bool
        The free fit was a body; False: this is the nearest one.
    """

    value_kg_m2: Floats
    std_kg_m2: Floats
    free: bool = True

    @property
    def unidentifiable(self) -> tuple[str, ...]:
        """Names of moments that the data do not determine, or of the whole inertia."""
        open_ = np.isnan(self.value_kg_m2)
        if open_.all():
            return (INERTIA_WHOLE,)
        return tuple(name for name, out in zip(INERTIA_PARTS, open_, strict=True) if out)


def central_tensor(ten: Floats) -> Floats:
    """Inertia (3, 3) about the centre of gravity of a body (10,) that is given about the link's origin."""
    mass, first = ten[0], ten[1:4]
    return tensor_of(ten[_MOMENTS]) - (first @ first * np.eye(3) - np.outer(first, first)) / mass


def second_moments(ten: Floats) -> Floats:
    """Second moments of mass (3, 3) about the centre of gravity; positive definite for a physical body."""
    tensor = central_tensor(ten)
    return 0.5 * np.trace(tensor) * np.eye(3) - tensor


def is_body(ten: Floats) -> bool:
    """Return whether ten parameters are physically consistent: the pseudo-inertia is positive definite."""
    if not (np.isfinite(ten).all() and ten[0] > 0):
        return False
    return bool(np.linalg.eigvalsh(second_moments(ten))[0] >= ten[0] * _THINNEST_M**2 * (1.0 - _SAME))


def nearest_body(ten: Floats, covariance: Floats) -> Floats:
    """Return the physical body nearest to ten free parameters (10,) in the metric of their covariance (10, 10).

    The unknowns are mass, centre of gravity and a triangular root of the second moments over the mass, so that every
    step is a body.
    """
    if is_body(ten):
        return ten
    # least uncertainty of the moments: a body that is barely too thin must not be corrected by its mass
    hair = np.concatenate([np.zeros(4), np.full(6, (ten[0] * _HAIR_M**2) ** 2)])
    whiten = _whitening(covariance + np.diag(hair))
    # Start values of a nearby physical body: negative second moments are cut off
    size, vectors = np.linalg.eigh(second_moments(ten) / ten[0])
    thick = (vectors * np.maximum(size, (10.0 * _THINNEST_M) ** 2)) @ vectors.T
    root = np.linalg.cholesky(thick)
    start = np.concatenate([[0.0], ten[1:4] / ten[0], root[np.tril_indices(3)]])
    found = least_squares(
        lambda unknown: whiten @ (_body(unknown, ten[0]) - ten),
        start,
        jac=lambda unknown: whiten @ _body_directions(unknown, ten[0]),  # pyright: ignore[reportArgumentType]
        max_nfev=1000,
    )
    return _body(found.x, ten[0])


def _whitening(covariance: Floats) -> Floats:
    std = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    size, vectors = np.linalg.eigh(covariance / std / std[:, None])
    return (vectors / np.sqrt(np.maximum(size, 1e-10 * size[-1]))).T / std


def _body(unknown: Floats, mass_kg: float) -> Floats:
    """Ten parameters of [log of mass over `mass_kg`, centre of gravity (3), triangular root (6)]."""
    mass, com = mass_kg * np.exp(np.clip(unknown[0], -5.0, 5.0)), unknown[1:4]
    root = np.zeros((3, 3))
    root[np.tril_indices(3)] = unknown[4:]
    second = mass * (root @ root.T + _THINNEST_M**2 * np.eye(3) + np.outer(com, com))
    tensor = np.trace(second) * np.eye(3) - second
    return np.concatenate([[mass], mass * com, tensor[np.triu_indices(3)]])


def _body_directions(unknown: Floats, mass_kg: float) -> Floats:
    """Derivatives (10, 10) of `_body`."""
    mass, com = mass_kg * np.exp(np.clip(unknown[0], -5.0, 5.0)), unknown[1:4]
    root, rows, columns = np.zeros((3, 3)), *np.tril_indices(3)
    root[rows, columns] = unknown[4:]
    half = np.zeros((9, 3, 3))  # changes of the second moments, without their mirror images
    half[np.arange(3), np.arange(3)] = com
    half[3 + np.arange(6), rows] = root[:, columns].T
    second = mass * (half + half.transpose(0, 2, 1))
    tensor = np.trace(second, axis1=1, axis2=2)[:, None, None] * np.eye(3) - second
    out = np.zeros((10, 10))
    out[:, 0] = _body(unknown, mass_kg)
    out[1:4, 1:4] = mass * np.eye(3)
    out[4:, 1:] = tensor[:, *np.triu_indices(3)].T
    return out


def central_directions(ten: Floats) -> Floats:
    """Derivatives (6, 10) of `INERTIA_PARTS` by the ten parameters."""
    mass, first = ten[0], ten[1:4]
    out = np.zeros((6, 10))
    out[:, 0] = (first @ first * np.eye(3) - np.outer(first, first))[ROW, COLUMN] / mass**2
    for k in range(3):
        unit = np.eye(3)[k]
        change = 2.0 * first[k] * np.eye(3) - np.outer(unit, first) - np.outer(first, unit)
        out[:, 1 + k] = -change[ROW, COLUMN] / mass
    out[np.arange(6), _MOMENTS] = 1.0
    return out


def load_inertia(body: Floats, covariance: Floats, *, free: bool) -> LoadInertia:
    """Inertia about the centre of gravity; moments with a large uncertainty stay open.

    Parameters
    ----------
    body : array of shape (10,)
        Physical body in the link's frame, as of `nearest_body`.
    covariance : array of shape (10, 10)
        Of the free fit.
    free : bool
        The free fit was a body.
    """
    tensor = central_tensor(body)
    turn = central_directions(body)
    std = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", turn, covariance, turn), 0.0))
    largest = float(np.linalg.eigvalsh(tensor)[-1])
    determined = std <= max(_LARGEST_STD * largest, body[0] * _SMALL_M**2)
    value = tensor[ROW, COLUMN]
    return LoadInertia(np.where(determined, value, np.nan), np.where(determined, std, np.nan), free)
