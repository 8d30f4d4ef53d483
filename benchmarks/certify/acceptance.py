"""One arm: identified, changed or not, judged by `accept` at the poses that its design asks for."""

from __future__ import annotations

import copy
import json
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.cell_file import invoked, write_cell_file
from benchmarks.conflict.answers import write_cell
from benchmarks.conflict.arm import AXES, Floats, gravity_torque
from benchmarks.conflict.plant import ConflictCell, LoadBlock, draw_cell, measure

#: Of the torque limit, which is ten times the root mean square of the torque of gravity: 5 % of that torque.
TOLERANCE_PERCENT = 0.5
#: Largest error anywhere in the workspace, over the tolerance.
ERROR = 2.0
#: Seconds from the identification to the acceptance.
LATER_S = 4000.0
#: Random postures by which the largest error is found, apart from those of `accept`.
POSTURES = 3000


def accepted_arm(seed: int) -> dict:
    """Outcome for one arm: every second one has an error, and which."""
    drawn = draw_cell(seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_cell_file(folder, drawn.arm.rated_kg, drawn.arm.geometry.limit_rad, 10.0 * drawn.size_nm)
        drawn.columns = measure(drawn)
        table, robot = write_cell(drawn, folder)
        result, cell = folder / "result.json", folder / "cell.toml"
        code, said = invoked("estimate", table, "--warm", "--cell", cell, "--json", result)
        # 7: the rating of the arm cannot be judged from the interval of the mass; the load is there
        if code not in (0, 7):
            return {"seed": seed, "outcome": "not identified", "said": said[-200:]}
        poses, resolution = chosen_poses(cell, result)
        rng = np.random.default_rng([seed, 10])
        kind = ""
        if seed % 2:
            kind = tuple(ERRORS)[seed // 2 % len(ERRORS)]
            drawn = with_error(drawn, kind, rng)
        last = drawn.blocks[-1]
        drawn.poses_rad = poses
        drawn.blocks = [LoadBlock("tool", "unseen", last.start_s + LATER_S, gain=last.gain, load="tool")]
        drawn.columns = measure(drawn)
        drawn.columns["pose"] = drawn.columns["pose"] + 1000
        urdf = robot.read_text(encoding="utf-8")
        table = write_cell(drawn, folder)[0].rename(folder / "unseen.csv")
        # a tilted base is in no file
        robot.write_text(urdf, encoding="utf-8")
        answer = folder / "answer.json"
        words = ("accept", cell, result, "--from", table, "--tolerance", f"{TOLERANCE_PERCENT}%")
        code, said = invoked(*words, "--json", answer)
        if not answer.exists():
            return {"seed": seed, "error": kind, "outcome": f"exit {code}", "said": said[-200:]}
        stated = json.loads(answer.read_text(encoding="utf-8"))
    return {
        "seed": seed,
        "error": kind,
        "outcome": stated["outcome"],
        "beyond": stated["probability_beyond_tolerance"],
        "likeliest": stated["likeliest_error"],
        "poses": len(poses),
        "resolution": resolution,
    }


def chosen_poses(cell: Path, result: Path) -> tuple[Floats, float]:
    """Poses (n, 6) that the design of `accept` asks for, paths between them not planned, and the expected std."""
    from gateway.acquire.planning import MOST_POSES, workspace_postures
    from gateway.acquire.poses import DISTANCE_RAD
    from gateway.identify.workspace_error import error_families, fewest_poses
    from gateway.identify.workspace_error import resolution as expected
    from gateway.motion.workspace import workspace_of
    from gateway.pipeline.inputs import ModelRequest, collect_inputs
    from gateway.pipeline.workspace_acceptance import entered_load, parse_tolerance, seen_postures
    from gateway.result.result import read_result

    about, stored = collect_inputs(ModelRequest(cell=cell), ()), read_result(result)
    assert about.arm is not None
    assert about.loaded is not None
    tolerance_nm = parse_tolerance(f"{TOLERANCE_PERCENT}%", about.arm)
    postures = workspace_postures(about.loaded, workspace_of(about.arm, about.model))
    families = error_families(entered_load(stored, None, about), postures, tolerance_nm)
    noise = np.array(stored.noise_floor_nm) / tolerance_nm
    distance = np.abs(postures[:, None] - seen_postures(stored, AXES)[None]).max(axis=2).min(axis=1)
    chosen = fewest_poses(families, noise, np.flatnonzero(distance >= DISTANCE_RAD), MOST_POSES)
    return postures[chosen], expected(families, noise, chosen)


def with_error(drawn: ConflictCell, kind: str, rng: np.random.Generator) -> ConflictCell:
    """The same arm with an error whose largest torque in the workspace is `ERROR` times the tolerance."""
    q_rad = np.random.default_rng(5).uniform(-0.99, 0.99, (POSTURES, AXES)) * drawn.arm.geometry.limit_rad
    tolerance_nm = TOLERANCE_PERCENT / 100 * 10.0 * drawn.size_nm
    right = _torque(drawn, q_rad)
    change = ERRORS[kind](drawn, rng)

    def largest(amplitude: float) -> float:
        return float((np.abs(_torque(change(amplitude), q_rad) - right) / tolerance_nm).max())

    amplitude = 1e-3
    for _ in range(6):
        amplitude *= ERROR / largest(amplitude)
    assert abs(largest(amplitude) - ERROR) < 0.02, (kind, largest(amplitude))
    return change(amplitude)


def _torque(drawn: ConflictCell, q_rad: Floats) -> Floats:
    """Torque (n, 6) that is read without friction and noise, the load mounted."""
    tau = gravity_torque(drawn.arm.geometry, drawn.true, q_rad + drawn.zero_rad, drawn.loads["tool"])
    if drawn.extra_nm is not None:
        tau = tau + drawn.extra_nm(q_rad, drawn.size_nm)
    return tau * (1.0 + drawn.gain) * drawn.blocks[-1].gain


Change = Callable[[float], ConflictCell]


def _load(row: Callable[[np.random.Generator], Floats]) -> Callable[[ConflictCell, np.random.Generator], Change]:
    """A load that is another one than the one entered: [mass, x, y, z] grow by an amount along a direction."""

    def of(drawn: ConflictCell, rng: np.random.Generator) -> Change:
        path = row(rng)

        def change(amplitude: float) -> ConflictCell:
            loads = {**drawn.loads, "tool": drawn.loads["tool"] + amplitude * path}
            return _like(drawn, loads=loads)

        return change

    return of


def _like(drawn: ConflictCell, **changes: object) -> ConflictCell:
    same = copy.copy(drawn)
    for name, value in changes.items():
        setattr(same, name, value)
    return same


def _spring(drawn: ConflictCell, rng: np.random.Generator) -> Change:
    """A balancer: torque of a spring between two points, over the angle of J2 or J3."""
    joint, middle, share = int(rng.integers(1, 3)), rng.uniform(-0.6, 0.6), rng.uniform(0.2, 0.6)

    def shape(q: Floats) -> Floats:
        turned = q[:, joint] - middle
        length = np.sqrt(1.0 + share**2 - 2.0 * share * np.cos(turned))
        return (1.0 - 0.8 / length) * share * np.sin(turned)

    return _extra(drawn, joint, shape)


def _cable(drawn: ConflictCell, rng: np.random.Generator) -> Change:
    """A cable on a wrist axis that pulls harder the further the joint turns, from some angle on."""
    joint, start = int(rng.integers(3, 6)), rng.uniform(-0.5, 0.5)
    return _extra(drawn, joint, lambda q: np.tanh(1.5 * (q[:, joint] - start)) + 0.3 * (q[:, joint] - start))


def _extra(drawn: ConflictCell, joint: int, shape: Callable[[Floats], Floats]) -> Change:
    unit = np.eye(AXES)[joint]

    def change(amplitude: float) -> ConflictCell:
        return _like(drawn, extra_nm=lambda q, size_nm: amplitude * size_nm[joint] * shape(q)[:, None] * unit)

    return change


def _tilt(drawn: ConflictCell, rng: np.random.Generator) -> Change:
    angle = rng.uniform(0, 2 * np.pi)

    def change(amplitude: float) -> ConflictCell:
        turn = (amplitude * float(np.cos(angle)), amplitude * float(np.sin(angle)), 0.0)
        return _like(drawn, arm=replace(drawn.arm, geometry=replace(drawn.arm.geometry, base_rpy_rad=turn)))

    return change


def _zero(drawn: ConflictCell, rng: np.random.Generator) -> Change:
    joint = int(rng.integers(1, 5))
    return lambda amplitude: _like(drawn, zero_rad=drawn.zero_rad + amplitude * np.eye(AXES)[joint])


def _hose(drawn: ConflictCell, rng: np.random.Generator) -> Change:
    """A hose on the forearm: a mass beside it."""
    place = drawn.arm.geometry.length_m[2] * np.array([rng.uniform(0.2, 0.8), rng.uniform(-0.2, 0.2), 0.2])

    def change(amplitude: float) -> ConflictCell:
        true = drawn.true.copy()
        mass_kg = true.mass_kg[2] + amplitude
        true.com_m[2] = (true.mass_kg[2] * true.com_m[2] + amplitude * place) / mass_kg
        true.mass_kg[2] = mass_kg
        return _like(drawn, true=true)

    return change


def _gain(drawn: ConflictCell, rng: np.random.Generator) -> Change:
    joint = int(rng.integers(1, 5))
    last = drawn.blocks[-1]
    return lambda amplitude: _like(
        drawn, blocks=[replace(last, gain=last.gain * (1.0 + amplitude * np.eye(AXES)[joint]))]
    )


ERRORS: dict[str, Callable[[ConflictCell, np.random.Generator], Change]] = {
    "mass of the load": _load(lambda rng: np.array([rng.choice([-1.0, 1.0]), 0.0, 0.0, 0.0])),
    "centre of the load": _load(lambda rng: np.array([0.0, *rng.standard_normal(3)])),
    "spring": _spring,
    "cable": _cable,
    "tilt": _tilt,
    "joint zero": _zero,
    "hose": _hose,
    "gain": _gain,
}


def acceptance_figures(arms: list[dict]) -> dict[str, dict]:
    """Wrong decisions, open ones, and poses."""
    from benchmarks.figure import figure

    def share(of: list[dict], outcome: str) -> float:
        return 100.0 * sum(arm["outcome"] == outcome for arm in of) / max(len(of), 1)

    judged = [arm for arm in arms if "poses" in arm]
    right = [arm for arm in judged if not arm["error"]]
    wrong = [arm for arm in judged if arm["error"]]
    named = f"acceptance: {len(wrong)} arms with an error of {ERROR:g} tolerances"
    found = {
        f"{named}: passed": figure(share(wrong, "pass"), "<= 2", "%"),
        f"acceptance: {len(right)} arms without an error: failed": figure(share(right, "fail"), "<= 2", "%"),
        "acceptance: most poses": figure(max(arm["poses"] for arm in judged), "<= 12"),
    }
    printed = {
        "acceptance: median poses": float(np.median([arm["poses"] for arm in judged])),
        "acceptance: with an error, cannot tell [%]": share(wrong, "cannot tell"),
        "acceptance: without an error, cannot tell [%]": share(right, "cannot tell"),
        "acceptance: arms that were not judged": float(len(arms) - len(judged)),
    }
    return found | {name: figure(value) for name, value in printed.items()}
