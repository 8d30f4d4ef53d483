"""commission --thermal on simulated drives whose torque drifts."""

from __future__ import annotations

import numpy as np
import pytest

from gateway.estimate import run as estimate
from gateway.identify.drift import AGAIN
from gateway.pipeline.inputs import ModelRequest, collect_inputs, read_rows, split_validation
from tests.system.conftest import with_few_poses

TRUTH_KG = 6.0
#: Of the torque that the drives of axes 2 and 3 show, since they were switched on.
PER_S = 4e-4
DRIFT = "".join(
    f'[[effect]]\nname = "thermal_drift"\njoints = [{joint}]\nparameters = {{ per_s = {PER_S} }}\n' for joint in (2, 3)
)


@pytest.mark.slow
def test_a_drift_cancels_where_the_loads_are_measured_forth_and_back(place, serve, commission, fast_arm):
    with_few_poses(place)
    code, result, hands, output = commission(fast_arm(serve(effect=DRIFT)), "--thermal", "--warm-up", "0.1")
    assert code in (0, 7), output.err
    assert hands.asked == ["load", "none", "load"]
    assert (place.folder / "out" / "warm-up.h5").exists()
    about = collect_inputs(ModelRequest(), [place.folder / "out" / "run.h5"])
    table, _ = split_validation(read_rows([place.folder / "out" / "run.h5"], about))

    def off_kg(chosen) -> float:
        """Off what the drives showed of the load halfway through these rows, by differences that model no drift."""
        rows = table.take(chosen)
        (load,) = estimate(rows, about.model, about.knowledge, "difference").loads
        return load.mass_kg - TRUTH_KG * (1.0 + PER_S * rows.time_s.mean())

    again = table.pose >= AGAIN
    first = np.isin(table.pose, table.pose[again] - AGAIN)  # without the further poses, which are measured once
    forth, back, both = off_kg(first), off_kg(again), off_kg(first | again)
    assert forth < 0.0 < back
    assert abs(both) < 0.6 * min(-forth, back), (both, forth, back)
    findings = [finding["where"] for finding in result["findings"] if "both measurements" in finding["what"]]
    assert {"J2", "J3"} <= set(findings)
    (load,) = result["loads"]
    assert abs(load["mass_kg"] - TRUTH_KG) < 4 * load["mass_std_kg"]
