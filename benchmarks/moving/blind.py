"""Blind cells in motion: arms drawn by nature with one mechanism that their owner does not state, or none.

python -m benchmarks.moving.blind [--seeds dev|test] [--cells N] [--out out/blind-moving] [--jobs N]

Each arm is moved unloaded and loaded along an excitation trajectory and diagnosed. Every third arm has no mechanism;
the others have one of `benchmarks.nature.moving_effects` in turn, of a strength from 1.5 to 20. Links, load, gains,
friction, rotors, delays and cogging take over a part of what the mechanism adds, each within its prior. The strength is
what is left on the axis where that is largest, in standard deviations of all rows, over the root of 24. A blind cell at
rest has 24 visits, and its strength is a root mean square over them. Friction that falls with speed is drawn in most
arms and may be named.
Development seeds start at 0, test seeds at 30000.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from benchmarks.blind.strict import LEAST, STRONG, Said, misnamed, right, there
from benchmarks.figure import HALF_WIDTH
from benchmarks.moving.cells import TIERS, MovingCell, draw_cell
from benchmarks.moving.oracle import beyond_nuisances
from benchmarks.nature.moving_cell import FINE, reported_nm
from benchmarks.nature.moving_effects import MAKERS, MovingEffect
from benchmarks.program import one_thread, options, run
from gateway.diagnose import diagnose
from gateway.errors import GatewayError
from gateway.model.robot import robot_from_urdf
from sim.blind import closest, wanted_strength

FIRST = {"dev": 0, "test": 30000}
#: Cells without a mechanism: one of so many.
CLEAN_EVERY = 3
VISITS = 24
PERIODS, RATE_HZ = 2, 50.0


def strength(cell: MovingCell, effect: MovingEffect) -> float:
    """Return the strength of a mechanism in the rows of both runs."""
    even = replace(cell.arm, friction=replace(cell.arm.friction, tail_share=np.zeros(6)))
    added = {}
    for label, start_s in cell.start_s.items():
        with_, without = (
            reported_nm(even, cell.motion, label, start_s, np.random.default_rng(0), entry)[0][::FINE]
            for entry in (effect, None)
        )
        added[label] = (with_ - without).reshape(cell.motion.periods, cell.motion.samples, -1)
    return float(beyond_nuisances(cell, added).max() / np.sqrt(VISITS))


def drawn(seed: int) -> tuple[MovingCell, float]:
    """Return the cell of a seed and the strength of its mechanism; inf where it has no size, 0 where there is none."""
    rng = np.random.default_rng([seed, 16])
    cell = draw_cell(seed, TIERS[seed % len(TIERS)], periods=PERIODS, rate_hz=RATE_HZ)
    number, place = divmod(seed, CLEAN_EVERY)
    if place == 0:
        return cell, 0.0
    name = list(MAKERS)[((CLEAN_EVERY - 1) * number + place - 1) % len(MAKERS)]
    maker, wanted = MAKERS[name], wanted_strength(rng)
    effect, reached = closest(lambda: maker(cell.arm, rng), lambda effect: strength(cell, effect), wanted)
    return replace(cell, effect=effect), reached


def run_cell(seed: int) -> dict:
    """Draw, measure, diagnose and score one seed."""
    cell, size = drawn(seed)
    found, loads = (), ()
    try:
        result = diagnose(cell.table(), robot_from_urdf(cell.stated.urdf, f"seed {seed}"), cell.knowledge)
        verdict, loads = result.verdict, result.loads
        found = tuple((effect.name, tuple(effect.joints)) for effect in result.effects)
    except GatewayError as error:
        verdict = f"refused: {error}"[:120]
    truth = [there(["velocity_friction"], [int(axis) + 1], 0.0) for axis in np.flatnonzero(cell.arm.breakaway_share)]
    if cell.effect is not None:
        truth.append(there([cell.effect.name], cell.effect.joints, size))
    said = Said(found, verdict)
    tool = np.array([cell.arm.tool.mass_kg, *cell.arm.tool.com_m])
    known = [load for load in loads if load.mass_kg is not None and load.com_m is not None]
    errors = [np.array([load.mass_kg, *load.com_m]) - tool for load in known]
    stds = [np.array([load.mass_std_kg, *load.com_std_m]) for load in known]
    return {
        "seed": seed,
        "mechanism": "none" if cell.effect is None else cell.effect.name,
        "strength": size,
        "verdict": verdict,
        "found": found,
        "right": right(truth, said),
        "misnamed": misnamed(truth, said),
        "mass_error": float(errors[0][0] / tool[0]) if errors else None,
        "inside": (np.abs(errors[0]) < HALF_WIDTH * stds[0]).tolist() if errors else [],
    }


def figures(cells: Sequence[dict]) -> dict[str, dict]:
    """Shares of right and false names, error of the load and coverage of its intervals."""
    from benchmarks.figure import middle, share

    clean = [cell for cell in cells if cell["mechanism"] == "none"]
    asked = [cell for cell in cells if cell["strength"] >= LEAST]
    return {
        "named, strength 3 and more": share(_hits(asked, "right", STRONG, np.inf), ">= 0.9"),
        "named, strength 1.5 to 3": share(_hits(asked, "right", LEAST, STRONG), ">= 0.7"),
        "something else named, with a mechanism": share(_hits(asked, "misnamed", LEAST, np.inf), "<= 0.05"),
        "named where there is no mechanism": share([float(cell["misnamed"]) for cell in clean], "<= 0.01"),
        "mass, no mechanism: error": middle(_errors(clean), unit="% of"),
        "mass, with a mechanism: error": middle(_errors(asked), unit="% of"),
        "95 % intervals that hold, no mechanism": share(_inside(clean), "0.93 .. 0.97"),
        "95 % intervals that hold, with a mechanism": share(_inside(asked), "0.93 .. 0.97"),
    }


def _hits(cells: Iterable[dict], key: str, least: float, below: float) -> list[float]:
    return [float(cell[key]) for cell in cells if least <= cell["strength"] < below or cell["strength"] == below]


def _errors(cells: Iterable[dict]) -> list[float]:
    return [100.0 * abs(cell["mass_error"]) for cell in cells if cell["mass_error"] is not None]


def _inside(cells: Iterable[dict]) -> list[float]:
    return [float(hit) for cell in cells for hit in cell["inside"]]


def main() -> int:
    """Exit 1 when a goal is missed."""
    parser = options(__doc__, "out/blind-moving", jobs=2)
    parser.add_argument("--seeds", choices=sorted(FIRST), default="dev")
    parser.add_argument("--cells", type=int, default=240)
    arguments = parser.parse_args()
    one_thread()
    from benchmarks.figure import conclude, print_table

    first = FIRST[arguments.seeds]
    cells = run(run_cell, range(first, first + arguments.cells), arguments.jobs, arguments.out / "cells.jsonl")
    table = []
    for name in ("none", *MAKERS):
        rows = [cell for cell in cells if cell["mechanism"] == name and (name == "none" or cell["strength"] >= LEAST)]
        said = [" + ".join(sorted({place[0] for place in cell["found"]})) or cell["verdict"] for cell in rows]
        counts = sorted({(-said.count(words), words) for words in said})[:4]
        words = ", ".join(f"{-count} {word}" for count, word in counts)
        table.append((name, len(rows), *(sum(c[key] for c in rows) for key in ("right", "misnamed")), words))
    columns = ("mechanism", "cells", "right", "something else named", "what was said")
    print_table(columns, table, "one mechanism")
    return conclude(figures(cells), arguments.out)


if __name__ == "__main__":
    raise SystemExit(main())
