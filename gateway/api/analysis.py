"""Measured data from files, estimates and diagnoses of them, as the commands of the same names give them."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
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
from gateway.model.placeholders import model_remarks
from gateway.pipeline.finalize import accept, check_against_data, finalize
from gateway.pipeline.inputs import (
    AnalysisInputs,
    ModelRequest,
    collect_inputs,
    read_rows,
    split_validation,
)
from gateway.result.acceptance import Expected
from gateway.result.data_roles import FIT, HELD_ROLE, refuse_used, roles_of, used_rows
from gateway.result.result import Result

#: One file, or several: recordings (`.h5`) and measured tables (`.csv`).
Files = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]


#: Shows a remark, and is open during a computation; without a person both do nothing.
Say = Callable[[str], None]
Working = Callable[[str], AbstractContextManager[None]]


def paths_of(files: Files) -> list[Path]:
    """Return the paths of one file or of several."""
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
    paths = paths_of(data)
    return read_rows(paths, collect_inputs(model or ModelRequest(), paths))


def estimate(
    data: Files,
    model: ModelRequest,
    *,
    method: str = "joint",
    coefficient: Coefficient | None = None,
    expected: Sequence[Expected] = (),
    operator: str | None = None,
    say: Say = lambda _text: None,
    working: Working = lambda _name: nullcontext(),
) -> Result:
    """Estimate mass and centre of gravity of every load that is not known, as `servo-gateway estimate`.

    Parameters
    ----------
    data : path or sequence of paths
        As of `read`.
    model : ModelRequest
        Cell or robot, and what is known of the loads.
    method : str
        `joint`, `difference`, `posture` or `coefficient`.
    coefficient : Coefficient, optional
        Inputs of the method of that name.
    expected : sequence of Expected
        Expected masses; the result says of each whether it passes.
    operator : str, optional
        Name of the operator, for the report.
    say : callable
        Shows a remark on the robot description.
    working : callable
        Called with the name of the computation; open until that is done.

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

    def fit(about: AnalysisInputs, table: Table) -> Result:
        how, axes = coefficient, () if about.arm is None else about.arm.axis
        if how is not None and 0 < how.joint <= len(axes):
            axis = axes[how.joint - 1]
            of_cell = {"gear_ratio": axis.gear_ratio.value, "gear_efficiency": axis.gear_efficiency.value}
            how = replace(how, **{name: value for name, value in of_cell.items() if getattr(how, name) is None})
        with working("estimation"):
            choice = postures(about)
            result = _estimate(table, about.robot, about.knowledge, method, coefficient=how, pose_choice=choice)
        return replace(result, data_roles=roles_of(table, earlier=about.bare_roles))

    return _analysed(fit, paths_of(data), (), model, expected, operator, say)


def diagnose(
    data: Files,
    model: ModelRequest,
    *,
    holdout: Files = (),
    only: Iterable[str] = (),
    without: Iterable[str] = (),
    expected: Sequence[Expected] = (),
    operator: str | None = None,
    say: Say = lambda _text: None,
    working: Working = lambda _name: nullcontext(),
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
    expected, operator, say, working
        As of `estimate`.

    Returns
    -------
    Result
        `verdict`, `effects` with their evidence, `before` and `after`, `loads` after the effects.

    Raises
    ------
    InputError, ConfigError
        A file, a statement or the name of an effect that cannot be used.
    DataUnusable
        Too few rows to fit, or none to hold out, or `holdout` holds rows of `data`, under any label or pose number.
    """
    unseen_paths, tried, untried = paths_of(holdout), frozenset(only), frozenset(without)
    for name in sorted((tried | untried) - set(LIBRARY)):
        raise InputError(f"'{name}' is not an effect; choose from {', '.join(sorted(LIBRARY))}")

    def fit(about: AnalysisInputs, table: Table) -> Result:
        with working("diagnosis"):
            seen, unseen = (table, read_rows(unseen_paths, about)) if unseen_paths else split_validation(table)
            if unseen is not None and unseen.axes == seen.axes:
                fitted = roles_of(seen, earlier=about.bare_roles, most_moving=len(seen))
                files = ", ".join(dict.fromkeys(seen.file))
                refuse_used(unseen, used_rows(unseen, fitted, (FIT,)), f"the fit of {files}")
            choice = partial(postures, about)
            result = _diagnose(
                seen, about.model, about.knowledge, holdout=unseen, only=tried, without=untried, pose_choice=choice
            )
        return replace(result, data_roles=roles_of(seen, unseen, result.provenance.get(HELD_ROLE), about.bare_roles))

    return _analysed(fit, paths_of(data), unseen_paths, model, expected, operator, say)


def _analysed(
    fit: Callable[[AnalysisInputs, Table], Result],
    data: Sequence[Path],
    holdout: Sequence[Path],
    model: ModelRequest,
    expected: Sequence[Expected],
    operator: str | None,
    say: Say,
) -> Result:
    """Read the files, fit, and complete the result."""
    paths = [*data, *holdout]
    about = collect_inputs(model, paths)
    for remark in () if about.robot is None else model_remarks(about.robot):
        say(remark)
    table = read_rows(data, about)
    check_against_data(expected, table, about)
    return accept(finalize(fit(about, table), about, table, paths, operator), expected, about.arm)


def postures(about: AnalysisInputs) -> NDArray[np.float64] | None:
    """Postures (k, N) [rad] that a result may ask for, within the limits of the cell; None without a cell."""
    if about.arm is None:
        return None
    from gateway.acquire.planning import (
        postures_to_ask,  # the planning code takes longer to import than the rest
    )

    return postures_to_ask(about)
