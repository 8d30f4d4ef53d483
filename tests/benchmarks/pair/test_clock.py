"""The pair in real time, its bench in lockstep: cycle after cycle with every limit in force."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

import numpy as np
import pytest

from benchmarks.pair.clock import PERIOD_S, Cycles, attempt, stepped
from drives.errors import DriveFault, MasterStalled
from gateway.pair.force import cause_of
from gateway.pair.pair_motion import PairStopped
from sim.pair.cell import PLANTS
from sim.pair.light import LightWorld


@pytest.fixture(params=["stays", "fades"])
def friction(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of joints at rest: as it was when they stopped, or released by their drives."""
    if request.param == "stays":
        return

    def fading(*plant: Any) -> LightWorld:
        world = LightWorld(*plant)
        motors = world.motors
        world.after.append(lambda _: np.multiply(world.friction, 0.9, world.friction, where=abs(motors.omega) < 1e-4))
        return world

    monkeypatch.setitem(PLANTS, "light", fading)  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.usefixtures("friction")
def test_friction_of_arms_that_stand_is_no_force_in_the_part() -> None:
    """Arms without errors, paths forward and back: the guard of the transfer to the start stops none of them."""
    with stepped(None, PERIOD_S) as bench:
        run = bench.begin("C1i", None)
        most = [bench.cycle(run) for _ in range(2)]
        bench.power.off()
    assert max(most) < 0.5 * bench.cell.config.force_limit_n


@pytest.mark.parametrize(
    ("error", "counted"),
    [
        (MasterStalled("this computer was stalled for 0.019 s"), "stalled"),
        (PairStopped(f"above 80 N; {cause_of(np.full(9, 90.0), 80.0, 0.004, 0.003)}"), "delayed"),
        (PairStopped(f"above 80 N; {cause_of(np.full(9, 90.0), 80.0, 0.004, 0.001)}"), "stopped"),
        (DriveFault("left OPERATION ENABLED: FAULT", node=3), "stopped"),
    ],
)
def test_a_stop_is_counted_by_who_is_to_blame(error: Exception, counted: str) -> None:
    def fails(_bench: object) -> None:
        raise error

    reported = Cycles(3, PERIOD_S)
    attempt(reported, lambda: nullcontext(None), fails)  # type: ignore[arg-type]
    assert {name: len(getattr(reported, name)) for name in ("stalled", "delayed", "stopped")} == {
        "stalled": 0,
        "delayed": 0,
        "stopped": 0,
    } | {counted: 1}
