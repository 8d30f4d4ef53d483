"""Processor time and memory of `diagnose` or `estimate` at rest by the number of visits.

python -m benchmarks.golden.growth VISITS [estimate]: one arm drawn by nature, bare and loaded; each
visit from both sides. A process of its own for each number: memory is the most that it ever had.
"""

from __future__ import annotations

import os
import resource
import sys
import time

#: Poses chosen for what they say of the load; further ones are drawn between them.
CHOSEN, SEED = 60, 3


def main(argv: list[str]) -> int:
    """Print visits, processor time, memory, verdict and mass."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    import numpy as np

    from benchmarks.blind.nature import knowledge_of
    from benchmarks.nature.nature_cell import VISIT_S, draw_cell
    from gateway.diagnose import diagnose
    from gateway.estimate import run
    from gateway.model.robot import robot_from_urdf
    from sim.offline import PlannedVisit
    from tests.support.rigs.tables import simulated_table

    half = int(argv[0]) // 2
    cell = draw_cell(SEED, "base")
    chosen = cell.poses(min(half, CHOSEN), 2)
    more = np.random.default_rng(1).uniform(chosen.min(axis=0), chosen.max(axis=0), (max(half - CHOSEN, 0), 6))
    poses = np.vstack([chosen, more])
    visits = [
        PlannedVisit(number, label, VISIT_S * (number + half * place), q)
        for place, label in enumerate(("none", "tool"))
        for number, q in enumerate(poses)
    ]
    table = simulated_table(cell.measure(visits, 99)[0], "many")
    robot = robot_from_urdf(cell.stated.urdf, "drawn")
    begin = time.process_time()
    if argv[1:] == ["estimate"]:
        result = run(table, robot, knowledge_of(cell))
    else:
        result = diagnose(table, robot, knowledge_of(cell))
    taken_s = time.process_time() - begin
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    load = result.loads[0]
    mass = f"{load.mass_kg} ± {load.mass_std_kg} kg"
    print(f"{2 * half} visits: {taken_s:.1f} s, {peak_mb:.0f} MB, {result.verdict}, {mass}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
