"""Compare the loads of a result with the operator's expectation and with the ratings of the cell file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from gateway.cell.config import ArmConfig
from gateway.data.table import Table
from gateway.identify.prior_loads import unknown_labels
from gateway.pipeline.inputs import AnalysisInputs
from gateway.result.acceptance import Expected, Rating, accepted, check_expected
from gateway.result.result import Result


def ratings(arm: ArmConfig | None) -> tuple[Rating, ...]:
    """Return the ratings of the cell file (load, reach, moment); empty without a cell file."""
    if arm is None:
        return ()
    said = {
        "mass": ("rated load", arm.rated_load_kg),
        "reach": ("rated reach", arm.rated_reach_m),
        "moment": ("rated moment", arm.rated_moment_nm),
    }
    return tuple(
        Rating(what, rated.value, f"{name}, {rated.source}")
        for what, (name, rated) in said.items()
        if rated is not None
    )


def check_against_data(expected: Sequence[Expected], tables: Iterable[Table], about: AnalysisInputs) -> None:
    """Refuse an expectation for a load that is not in the data.

    Raises
    ------
    InputError
        The data lack a load; the message names its label.
    """
    present = [str(label) for table in tables for label in table.load]
    check_expected(expected, (*unknown_labels(present, about.knowledge.known), *about.knowledge.parts))


def accept(result: Result, expected: Sequence[Expected], arm: ArmConfig | None) -> Result:
    """Return the result with its loads compared with expectation and rating."""
    return accepted(result, expected, ratings(arm))
