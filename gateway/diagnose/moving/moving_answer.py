"""Loads and nuisance parameters of a diagnosed run: the fit that `estimate` reports, with the named effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from gateway.data.table import Table
from gateway.diagnose.moving.lag import prepare_in_step
from gateway.errors import DataUnusable
from gateway.identify.knowledge import Knowledge
from gateway.identify.load_estimate import load_result, refused_load
from gateway.identify.motion.columns import MovingSetup
from gateway.identify.motion.effects import Effects
from gateway.identify.motion.moving_fit import fit_motion
from gateway.identify.motion.moving_results import loads_of, nuisances
from gateway.identify.prior_loads import unknown_labels
from gateway.model.robot import Robot
from gateway.model.term import Term
from gateway.result.result import Finding, LoadResult, NuisanceResult

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class MovingAnswer:
    """Loads and nuisance parameters as the result file has them."""

    loads: tuple[LoadResult, ...]
    nuisance: Mapping[str, NuisanceResult]
    findings: tuple[Finding, ...] = ()


def answer_of(table: Table, robot: Robot, knowledge: Knowledge, terms: Sequence[Term], delay_s: Floats) -> MovingAnswer:
    """Fit the moving rows of a table with the effects `terms` and torque delays `delay_s` (N,).

    If the table cannot be fitted, every load is refused with the reason.
    """
    moving = table.take(table.moving)
    knowledge, effects = knowledge.of_loads(moving.load), None
    if terms:
        gravity_m_s2 = np.asarray(knowledge.gravity_m_s2)
        rows_of = partial(
            prepare_in_step, holdout=None, robot=robot, gravity_m_s2=gravity_m_s2, delay_s=delay_s, largest=np.inf
        )
        effects = Effects(tuple(terms), rows_of)
    try:
        found = fit_motion(moving, robot, knowledge, MovingSetup(), effects=effects)
    except DataUnusable as error:
        labels = unknown_labels(moving.load, knowledge.known)
        return MovingAnswer(tuple(load_result(refused_load(label, str(error)), robot) for label in labels), {})
    usual = {} if found.fit is None else nuisances(found.fit)
    return MovingAnswer(tuple(load_result(load, robot) for load in loads_of(found, robot)), usual, found.findings)
