"""Loads held against what a person expects of them, and against what the cell says the arm is rated for."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from gateway.cell.config import ArmConfig
from gateway.data.table import Table
from gateway.identify.loads import unknown_labels
from gateway.pipeline.inputs import AnalysisInputs
from gateway.result.acceptance import Expected, Rating, accepted, check_expected
from gateway.result.result import Result


def ratings(arm: ArmConfig | None) -> tuple[Rating, ...]:
    """What the cell says that the arm is rated for; nothing without a cell."""
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
    """Make sure that the data hold every load that something is expected of.

    Raises
    ------
    InputError
        Names the label.
    """
    present = [str(label) for table in tables for label in table.load]
    check_expected(expected, unknown_labels(present, about.known))


def accept(result: Result, expected: Sequence[Expected], arm: ArmConfig | None) -> Result:
    """A completed result with its loads held against expectation and rating."""
    return accepted(result, expected, ratings(arm))
