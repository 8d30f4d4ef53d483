"""Some hundred inputs for each target; `python -m benchmarks.chaos fuzz` runs the full number."""

from __future__ import annotations

import pytest

from benchmarks.fuzz.runner import run
from benchmarks.fuzz.targets import TARGETS, Target

SHORT = {"decoder": 150, "reader": 60}


@pytest.mark.slow
@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_input_from_strangers(target: Target) -> None:
    run(target, max(10, round(SHORT[target.kind] * target.share)))
