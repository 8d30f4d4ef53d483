"""What a rehearsal predicts, against blind arms of the same cell.

python -m benchmarks.rehearsal CELL REHEARSAL.json [--arms 100] [--clean 100] [--jobs 2] [--out out/rehearsal]

REHEARSAL.json is what `servo-gateway rehearse CELL` wrote with all effects. Each blind arm has one effect with a size,
any as likely, at a strength of 0.3 to 12 (every factor as likely), drawn from seeds that the rehearsal does not use.
Three things are compared. By effect: the strength from which half of the arms have it named. The pairs that were
confused. On arms without an effect: the standard deviation of the load over its root mean square error.
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.program import one_thread, options, run

FIRST_SEED = 1_000_000
STRENGTHS = (0.3, 12.0)


def main() -> int:
    """Exit 1 when a goal is missed."""
    parser = options(__doc__, "out/rehearsal", jobs=2)
    parser.add_argument("cell", type=Path)
    parser.add_argument("rehearsal", type=Path)
    parser.add_argument("--arms", type=int, default=100)
    parser.add_argument("--clean", type=int, default=100)
    arguments = parser.parse_args()
    one_thread()
    from benchmarks.figure import conclude
    from gateway.jobs.rehearse import summary

    said = json.loads(arguments.rehearsal.read_text(encoding="utf-8"))
    seeds = range(arguments.arms + arguments.clean)
    tasks = [(arguments.cell, said["plan"], number < arguments.arms, FIRST_SEED + number) for number in seeds]
    blind = run(blind_arm, tasks, arguments.jobs, arguments.out / "arms.jsonl")
    seen = summary(blind, said["plan"]["duration_s"])
    return conclude(figures(said, seen), arguments.out)


def blind_arm(task: tuple[Path, dict[str, Any], bool, int]) -> dict[str, Any]:
    """Draw, measure and diagnose one arm; as an entry of `runs` of a rehearsal."""
    import numpy as np

    from gateway.api import ModelRequest
    from gateway.api.analysis import postures
    from gateway.diagnose import diagnose
    from gateway.jobs.rehearse import FAMILIES
    from gateway.motion.assumed import reference_load
    from gateway.motion.workspace import workspace_of
    from gateway.pipeline.inputs import collect_inputs, read_rows
    from sim.rehearsal import answered

    cell, plan, has_effect, seed = task
    rng = np.random.default_rng([seed, 3])
    about = collect_inputs(ModelRequest(cell=cell), ())
    effect, joints, strength = None, [], 0.0
    if has_effect:
        places = {
            name: each for name, each in answered(cell, None, {}).items() if name not in FAMILIES["wiring and settings"]
        }
        effect = str(rng.choice(sorted(places)))
        joints = places[effect][int(rng.integers(len(places[effect])))]
        strength = float(np.exp(rng.uniform(*np.log(STRENGTHS))))
    workspace = workspace_of(about.arm, about.model)
    with tempfile.TemporaryDirectory() as folder:
        table = Path(folder) / "table.csv"
        request = {
            "table": str(table), "seed": seed, "load": 0, "effect": effect, "joints": joints, "strength": strength,
            "q_rad": plan["q_rad"], "visit_s": plan["duration_s"] / len(plan["q_rad"]),
            "largest_kg": reference_load(workspace, np.array(plan["q_rad"]))[0], "link_std": about.knowledge.trust,
            "gain_std": list(about.knowledge.gain_std),
        }  # fmt: skip
        truth = answered(cell, None, request)
        found = diagnose(read_rows([table], about), about.model, about.knowledge, pose_choice=lambda: postures(about))
    names = [[each.name, list(each.joints)] for each in found.effects]
    listed = [effect, joints] in names
    load = next(each for each in found.loads if each.label == truth["load"])
    error = [load.mass_kg - truth["mass_kg"], *np.subtract(load.com_m, truth["com_m"]).tolist()]
    estimate = {"mass_kg": truth["mass_kg"], "error": error, "std": [load.mass_std_kg, *load.com_std_m]}
    known = {"effect": effect, "joints": joints, "found": names, "listed": listed, "estimate": estimate}
    named = listed and found.verdict != "undecided"
    return truth | known | {"named": named, "verdict": found.verdict, "next": None, "calibrated": None, "seed": seed}


def figures(said: dict[str, Any], seen: dict[str, Any]) -> dict[str, dict]:
    """Figures of a rehearsal against what blind arms gave, both as `summary` counts them."""
    import numpy as np

    from benchmarks.figure import figure, share
    from gateway.jobs.rehearse import detection

    sized = [[run for run in body["runs"] if run["effect"] and run["strength"] is not None] for body in (said, seen)]
    names = sorted({run["effect"] for run in sized[1]})
    strengths, stds = [], []
    for runs in sized:
        there = [run for run in runs if run["effect"] in names]
        columns = zip(*((run["strength"], names.index(run["effect"]), run["named"]) for run in there), strict=True)
        strength, place, named = map(np.array, columns)
        middle, std, _ = detection(strength, place, named)
        strengths.append(np.exp(middle))
        stds.append(std)
    ratio, blurred = strengths[1] / strengths[0], np.hypot(*stds)
    out = {
        "effects: strength of blind arms within 25 % of the rehearsal's": share(
            [float(0.8 <= value <= 1.25) for value in ratio], ">= 0.8"
        ),
        "effects: within 25 % or their own 95 % interval": share(
            [
                float(0.8 <= value <= 1.25 or abs(np.log(value)) < 1.96 * b)
                for value, b in zip(ratio, blurred, strict=True)
            ]
        ),
    }
    out |= {
        f"{name}: strength, blind arms over rehearsal": figure(
            float(ratio[k]), interval=[float(ratio[k] * np.exp(side * 1.96 * blurred[k])) for side in (-1.0, 1.0)]
        )
        for k, name in enumerate(names)
    }
    pairs = [{tuple(pair["effects"]) for pair in body["confused"]} for body in (said, seen)]
    stated, real = said["load"]["as_stated"], seen["load"]["as_stated"]
    return out | {
        "pairs said to be confused that blind arms confuse": share([float(p in pairs[1]) for p in pairs[0]], ">= 0.8"),
        "pairs that blind arms confuse and that were not said": share(
            [float(p not in pairs[0]) for p in pairs[1]], "<= 0.1"
        ),
        "mass: stated by the rehearsal over root mean square error of blind arms": figure(
            stated["mass_std_share"] / real["mass_rms_error_share"], "0.9 .. 1.15", f"of {real['arms']} arms"
        ),
        "95 % intervals of the load that hold": share(
            [1.0] * real["inside"] + [0.0] * (real["intervals"] - real["inside"])
        ),
    }


if __name__ == "__main__":
    raise SystemExit(main())
