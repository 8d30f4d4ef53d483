"""Baseline of the benchmark: plain weighted least squares with links at their priors, both runs in one fit."""

from __future__ import annotations

from benchmarks.loads.bodies import Identified, identified
from benchmarks.moving.timing import plain_least_squares
from benchmarks.naming.cells import Cell
from benchmarks.naming.methods import columns_of, load_by_least_squares

#: Places among the three parameters of an axis.
PLACES = {"coulomb_nm": 0, "viscous_nm_s_rad": 1, "rotor_inertia_kg_m2": 2}


def identify(cell: Cell, moving: bool) -> Identified:
    """Fit the load of a cell."""
    if not moving:
        return Identified(*load_by_least_squares(columns_of(cell), ()))
    found, covariance = plain_least_squares(cell.urdf, cell.link_std, cell.table)
    first = 10 * cell.table.q_rad.shape[1]
    load = slice(first, first + 10)
    axes = {name: tuple(found[first + 10 + place :: 3].tolist()) for name, place in PLACES.items()}
    return identified(found[load], covariance[load, load], axes)
