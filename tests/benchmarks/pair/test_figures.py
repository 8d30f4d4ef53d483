"""What the rows of another day come to."""

from __future__ import annotations

import pytest

from benchmarks.pair.bus_figures import figures


def row(trouble: str, force_n: float, *, goes_on: bool, stopped: bool = False, named: bool = False) -> dict:
    record = {"trouble": trouble, "force_n": force_n, "goes_on": goes_on, "stopped": stopped, "named": named}
    return {"row": "hostile", "seed": 3, "speed": 1.5, "cycle": 0, **record}


@pytest.mark.parametrize(
    ("found", "met"),
    [
        (row("friction", 39.0, goes_on=True), True),
        (row("friction", 41.0, goes_on=True), False),
        (row("friction", 39.0, goes_on=True, stopped=True), False),
        (row("slip", 79.0, goes_on=False, stopped=True, named=True), True),
        (row("slip", 81.0, goes_on=False, stopped=True, named=True), False),
        (row("slip", 79.0, goes_on=False, stopped=True), False),
    ],
)
def test_another_day_is_borne_or_stopped_in_time_and_named(found, met):
    figure = figures([found], 40.0, judged=False)[f"another day: {found['trouble']}"]
    assert figure["met"] is met
    assert figure["value"] == found["force_n"]
