"""Measured data from files, estimates and diagnoses of them, as the commands of the same names give them."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gateway.data.table import Table
from gateway.diagnose import diagnose as _diagnose
from gateway.errors import InputError
from gateway.estimate import Coefficient
from gateway.estimate import run as _estimate
from gateway.model.effects import LIBRARY
from gateway.pipeline.finalize import accept, finalize
from gateway.pipeline.inputs import (
    AnalysisInputs,
    ModelRequest,
    collect_inputs,
    read_rows,
    split_validation,
)
from gateway.result.data_roles import FIT, HELD_ROLE, refuse_used, roles_of, used_rows
from gateway.result.result import Result

#: One file, or several: recordings (`.h5`) and measured tables (`.csv`).
Files = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]


def _paths(files: Files) -> list[Path]:
    return [Path(files)] if isinstance(files, str | os.PathLike) else [Path(each) for each in files]


def read(data: Files, model: ModelRequest | None = None) -> Table:
    """Read the rows of recordings and measured tables; a row that is in two files counts once.

    Parameters
    ----------
    data : path or sequence of paths
        `.h5` recordings and `.csv` tables.
    model : ModelRequest, optional
        Cell or robot. Tables of motor torque or current need `cell`.

    Returns
    -------
    Table
        Arrays of shape (rows, axes): `q_rad`, `tau_nm` and others, and `load`, `pose`, `time_s` of shape (rows,).

    Raises
    ------
    InputError, ConfigError
        A file that cannot be used, with its line.
    """
    paths = _paths(data)
    return read_rows(paths, collect_inputs(model or ModelRequest(), paths))


def estimate(data: Files, model: ModelRequest, *, method: str = "joint") -> Result:
    """Estimate mass and centre of gravity of every load that is not known, as `servo-gateway estimate`.

    Parameters
    ----------
    data : path or sequence of paths
        As of `read`.
    model : ModelRequest
        Cell or robot, and what is known of the loads.
    method : str
        `joint`, `difference` or `posture`.

    Returns
    -------
    Result
        `loads` with standard deviations; `findings` with what the data contradict.

    Raises
    ------
    InputError, ConfigError
        A file or a statement that cannot be used.
    DataUnusable
        The data do not determine a load: rank, too few poses.
    """
    paths = _paths(data)
    about = collect_inputs(model, paths)
    table = read_rows(paths, about)
    return accept(finalize(estimated(about, table, method), about, table, paths), (), about.arm)


def diagnose(
    data: Files, model: ModelRequest, *, holdout: Files = (), only: Iterable[str] = (), without: Iterable[str] = ()
) -> Result:
    """Find the effects that the model lacks, judged on data that no fit has seen, as `servo-gateway diagnose`.

    Parameters
    ----------
    data : path or sequence of paths
        As of `read`.
    model : ModelRequest
        Cell or robot, and what is known of the loads.
    holdout : path or sequence of paths
        Data for the judgement alone. Without it visits marked `x_validation`, else blocks of the data.
    only, without : iterable of str
        Names of effects to try alone, or not to try.

    Returns
    -------
    Result
        `verdict`, `effects` with their evidence, `before` and `after`, `loads` after the effects.

    Raises
    ------
    InputError, ConfigError
        A file, a statement or the name of an effect that cannot be used.
    DataUnusable
        Too few rows to fit, or none to hold out, or `holdout` holds rows of `data`.
    """
    paths, unseen_paths, names = _paths(data), _paths(holdout), (frozenset(only), frozenset(without))
    for name in sorted(frozenset.union(*names) - set(LIBRARY)):
        raise InputError(f"'{name}' is not an effect; choose from {', '.join(sorted(LIBRARY))}")
    about = collect_inputs(model, [*paths, *unseen_paths])
    table = read_rows(paths, about)
    found = diagnosed(about, table, unseen_paths, *names)
    return accept(finalize(found, about, table, [*paths, *unseen_paths]), (), about.arm)


def estimated(about: AnalysisInputs, table: Table, method: str, coefficient: Coefficient | None = None) -> Result:
    """Return the estimate of all loads in the rows of a table."""
    choice = postures(about)
    result = _estimate(table, about.robot, about.knowledge, method, coefficient=coefficient, pose_choice=choice)
    return replace(result, data_roles=roles_of(table, earlier=about.bare_roles))


def diagnosed(
    about: AnalysisInputs, table: Table, holdout: Sequence[Path], only: frozenset[str], without: frozenset[str]
) -> Result:
    """Return the diagnosis of the rows of a table, judged on the files `holdout` or on visits of validation poses.

    Raises
    ------
    DataUnusable
        As `diagnose`, or rows of the hold-out are in the table too, under any label or pose number.
    """
    seen, unseen = (table, read_rows(holdout, about)) if holdout else split_validation(table)
    if unseen is not None and unseen.axes == seen.axes:
        fitted = roles_of(seen, earlier=about.bare_roles, most_moving=len(seen))
        refuse_used(unseen, used_rows(unseen, fitted, (FIT,)), f"the fit of {', '.join(dict.fromkeys(seen.file))}")
    choice = partial(postures, about)
    result = _diagnose(
        seen, about.model, about.knowledge, holdout=unseen, only=only, without=without, pose_choice=choice
    )
    return replace(result, data_roles=roles_of(seen, unseen, result.provenance.get(HELD_ROLE), about.bare_roles))


def postures(about: AnalysisInputs) -> NDArray[np.float64] | None:
    """Postures (k, N) [rad] that a result may ask for, within the limits of the cell; None without a cell."""
    if about.arm is None:
        return None
    from gateway.acquire.planning import (
        postures_to_ask,  # the planning code takes longer to import than the rest
    )

    return postures_to_ask(about)
