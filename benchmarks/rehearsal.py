"""What a rehearsal predicts, against blind arms of the same cell.

python -m benchmarks.rehearsal CELL REHEARSAL.json [--arms 400] [--clean 100] [--jobs 2] [--out out/rehearsal]

REHEARSAL.json is what `servo-gateway rehearse CELL` wrote with all effects. Each blind arm has one effect with a size,
any as likely, at any of its places. Its strength is a third to three times the one from which the rehearsal says that
the effect is named, every factor as likely. Its seed is none of the rehearsal's.
Three things are compared. By effect: the factor on the rehearsal's strengths with which half of the arms have it named.
The pairs that were confused. On arms without an effect: the standard deviation of the load over its root mean square
error.
"""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.program import one_thread, options, run

FIRST_SEED = 1_000_000
#: Largest factor between the strength of a blind arm and that of the rehearsal.
APART = 3.0


def main() -> int:
    """Exit 1 when a goal is missed."""
    parser = options(__doc__, "out/rehearsal", jobs=2)
    parser.add_argument("cell", type=Path)
    parser.add_argument("rehearsal", type=Path)
    parser.add_argument("--arms", type=int, default=400)
    parser.add_argument("--clean", type=int, default=100)
    arguments = parser.parse_args()
    one_thread()
    from benchmarks.figure import conclude
    from gateway.jobs.rehearse import summary

    said = json.loads(arguments.rehearsal.read_text(encoding="utf-8"))
    seeds = range(arguments.arms + arguments.clean)
    task = {key: said[key] for key in ("plan", "effects")} | {"cell": arguments.cell}
    tasks = [task | {"has_effect": number < arguments.arms, "seed": FIRST_SEED + number} for number in seeds]
    blind = run(blind_arm, tasks, arguments.jobs, arguments.out / "arms.jsonl")
    seen = summary(blind, said["plan"]["duration_s"])
    return conclude(figures(said, seen), arguments.out)


def blind_arm(task: dict[str, Any]) -> dict[str, Any]:
    """Draw, measure and diagnose one arm; as an entry of `runs` of a rehearsal."""
    import numpy as np

    from gateway.api import ModelRequest
    from gateway.jobs.rehearse import drawn_run
    from gateway.pipeline.inputs import collect_inputs
    from sim.rehearsal import answered

    rng = np.random.default_rng([task["seed"], 3])
    effect, joints, strength = None, [], 0.0
    if task["has_effect"]:
        sized = [entry for entry in task["effects"] if "detection_strength" in entry]
        effect = str(rng.choice(sorted({entry["name"] for entry in sized})))
        places = [entry for entry in sized if entry["name"] == effect]
        place = places[int(rng.integers(len(places)))]
        joints = place["joints"]
        strength = place["detection_strength"] * float(np.exp(rng.uniform(-1.0, 1.0) * np.log(APART)))
    about = collect_inputs(ModelRequest(cell=task["cell"], calibrated=False), ())
    return drawn_run(about, task["plan"], partial(answered, task["cell"], None), task["seed"], effect, joints, strength)


def figures(said: dict[str, Any], seen: dict[str, Any]) -> dict[str, dict]:
    """Figures of a rehearsal against what blind arms gave, both as `summary` counts them."""
    import numpy as np

    from benchmarks.figure import HALF_WIDTH, figure, share
    from gateway.jobs.rehearse import detection

    places = {(entry["name"], *entry["joints"]): entry for entry in said["effects"] if "detection_strength" in entry}
    arms = [arm for arm in seen["runs"] if arm["effect"] is not None]
    names = sorted({arm["effect"] for arm in arms})
    factor, std, _ = detection(
        np.array([arm["strength"] / places[arm["effect"], *arm["joints"]]["detection_strength"] for arm in arms]),
        np.array([names.index(arm["effect"]) for arm in arms]),
        np.array([arm["named"] for arm in arms]),
    )
    ratio = np.exp(factor)
    # that of the rehearsal: a mean over the places of the effect
    widths = [[np.ptp(np.log(places[key]["interval"])) for key in places if key[0] == name] for name in names]
    said_std = [float(np.hypot.reduce(width)) / len(width) / (2.0 * HALF_WIDTH) for width in widths]
    both = np.hypot(std, said_std)
    near = (ratio >= 0.8) & (ratio <= 1.25)
    out = {
        "effects: strength of blind arms within 25 % of the rehearsal's": share(near.astype(float), ">= 0.8"),
        "effects: within 25 % or the 95 % interval of the ratio": share(
            (near | (np.abs(factor) < HALF_WIDTH * both)).astype(float)
        ),
    }
    out |= {
        f"{name}: strength, blind arms over rehearsal": figure(
            float(ratio[k]), interval=np.exp(factor[k] + HALF_WIDTH * both[k] * np.array([-1.0, 1.0])).tolist()
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
        "confused arms whose pair was said": share(
            [float(tuple(pair["effects"]) in pairs[0]) for pair in seen["confused"] for _ in range(pair["arms"])]
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
