"""Identify a load, follow a path without and with feedforward; print every figure and write `summary.json`.

python -m benchmarks.follow [--out out/follow] [--seeds 1 2 3]

The simulated arms have links that differ from the drawing (a seed each), friction that scatters between
motions, and drives of which the gateway has the profile. One report is left beside the summary.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.figure import conclude, figure
from benchmarks.program import options
from gateway.cell.config import load_cell
from gateway.follow.settings import prepare
from gateway.result.follow import FedTrend, FollowResult, follow_from_json
from tests.support.follow import rig

SEEDS = (1, 2, 3)
WRONG = (0.8, 1.2)
WATCHED = (1, 2)
ROUNDS = 20_000


def main() -> int:
    """Exit 1 when a goal is missed."""
    parser = options(__doc__, "out/follow")
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS, help="build errors of the large arm")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    figures: dict[str, dict] = {}
    with tempfile.TemporaryDirectory() as folder:
        jobs = [("large", seed) for seed in arguments.seeds] + [("small", arguments.seeds[0])]
        results: dict[str, list[FollowResult]] = {"large": [], "small": []}
        wrong: list[FollowResult] = []
        untyped: list[FollowResult] = []
        for number, (example, seed) in enumerate(jobs, start=1):
            print(f"{number}/{len(jobs)}: {example} arm, build errors {seed}", file=sys.stderr, flush=True)
            place = rig.set_up(Path(folder) / f"{example}-{seed}", example)
            with rig.drives(place, seed) as handle:
                rig.identify(place, handle)
                report = arguments.out / f"{example}-{seed}.html"
                command = rig.follow_command(place, handle, place.result, report)
                assert command.exit_code == 0, command.output
                results[example].append(follow_from_json(report.with_suffix(".json").read_text(), "follow.json"))
                wrong += _wrong(place, handle)
                untyped.append(_nothing_typed(place, handle, seed))
                if number == 1:
                    figures |= _with_wrong_efficiency(place, handle)
                    figures |= _computing(place)
        first = f"{jobs[0][0]}-{jobs[0][1]}"
        shutil.copy(arguments.out / f"{first}.html", arguments.out / "report.html")
    figures = _following(results) | _untyped(untyped) | _loads(results, wrong) | figures
    return conclude(figures, arguments.out)


def _following(results: dict[str, list[FollowResult]]) -> dict[str, dict]:
    found: dict[str, dict] = {}
    for example, several in results.items():
        each = [rig.peaks(result) for result in several]
        for axis in WATCHED:
            for other, goal in (("off", "<= 0.3333"), ("maximum", "<= 0.5")):
                ratio = [item["identified"][axis] / item[other][axis] for item in each]
                name = f"{example} arm, axis {axis + 1}: peak error, identified load over {_words(other)}"
                found[name] = figure(max(ratio), goal, interval=(min(ratio), max(ratio)))
        worst = [float((item["identified"] / item["off"]).max()) for item in each]
        name = f"{example} arm: worst axis, identified load over without"
        found[name] = figure(max(worst), "<= 1", interval=(min(worst), max(worst)))
    return found


def _words(setting: str) -> str:
    return "without" if setting == "off" else "maximum load"


def _nothing_typed(place: rig.Place, handle: Any, seed: int) -> FollowResult:
    """The path with a cell in which no rotor and no friction is typed, and all of it identified in motion."""
    cell, result = rig.nothing_typed(place, handle, seed)
    return rig.followed(handle, cell, place.path, result, "off", "maximum", "identified")


def _untyped(several: list[FollowResult]) -> dict[str, dict]:
    found: dict[str, dict] = {}
    for other, goal in (("off", "<= 0.01"), ("maximum", "<= 0.25")):
        ratio = [
            float(item["identified"][axis] / item[other][axis]) for item in map(rig.peaks, several) for axis in WATCHED
        ]
        name = f"nothing typed, all identified: axes 2 and 3, identified load over {_words(other)}"
        found[name] = figure(max(ratio), goal, interval=(min(ratio), max(ratio)))
    worst = [float((item["identified"] / item["off"]).max()) for item in map(rig.peaks, several)]
    name = "nothing typed, all identified: worst axis, identified load over without"
    found[name] = figure(max(worst), "<= 1", interval=(min(worst), max(worst)))
    return found


def _wrong(place: rig.Place, handle: Any) -> list[FollowResult]:
    """The same pass with a load that is 20 % too light or too heavy in the file."""
    return [
        rig.followed(handle, place.cell, place.path, place.result_with(f"wrong-{factor}", factor), "identified")
        for factor in WRONG
    ]


def _failed(result: FollowResult) -> bool:
    return any(item.severity == "fail" and item.where.startswith("load") for item in result.findings)


def _trend(result: FollowResult) -> FedTrend:
    assert result.trend is not None
    return result.trend


def _loads(results: dict[str, list[FollowResult]], wrong: list[FollowResult]) -> dict[str, dict]:
    right = [result for several in results.values() for result in several]
    slope = [abs(_trend(result).scale) / _trend(result).scale_std for result in wrong]
    alarms = sum(any(item.severity != "info" for item in result.findings) for result in right)
    share = [abs(_trend(result).scale) for result in right]
    return {
        "load 20 % off: found by the residual's trend, share": figure(np.mean([_failed(b) for b in wrong]), ">= 1"),
        "load 20 % off: trend in standard deviations, least": figure(
            min(slope), ">= 3", interval=(min(slope), max(slope))
        ),
        "load as identified: findings that warn or fail": figure(float(alarms), "== 0"),
        "load as identified: trend of the residual, largest": figure(
            max(share), unit="of the load", interval=(min(share), max(share))
        ),
    }


def _with_wrong_efficiency(place: rig.Place, handle: Any) -> dict[str, dict]:
    """The same with gear efficiencies in the cell file that are five points below what the gears do."""
    pattern = r"gear_efficiency = \{ value = 0\.8(\d?)"
    cell = place.changed_cell("restated", pattern, r"gear_efficiency = { value = 0.75")
    request = place.path, place.result
    command = rig.peaks(rig.followed(handle, cell, *request, "maximum", "identified"))
    right = rig.peaks(rig.followed(handle, place.cell, *request, "velocity alone", "identified"))
    values = {
        "large arm with 5 to 10 points less gear efficiency stated: axes 2 and 3, identified over maximum load": max(
            float(command["identified"][axis] / command["maximum"][axis]) for axis in WATCHED
        ),
        "large arm: axes 2 and 3, identified load over the velocity offset alone": max(
            float(right["identified"][axis] / right["velocity alone"][axis]) for axis in WATCHED
        ),
    }
    return {name: figure(value) for name, value in values.items()}


def _computing(place: rig.Place) -> dict[str, dict]:
    """Processor time of both offsets of six axes, over the states of the path."""
    loaded = load_cell(place.cell)
    prepared = prepare(loaded, loaded.cell.arm[0], place.path, place.result)
    law = prepared.settings[-1].law
    assert law is not None
    motion = prepared.path.motions[0]
    states = list(zip(*(a.tolist() for a in (motion.q_rad, motion.qd_rad_s, motion.qdd_rad_s2)), strict=True))
    times = []
    for _ in range(5):
        sense = [0.0] * 6
        begun = time.thread_time()
        for index in range(ROUNDS // 5):
            q, velocity, acceleration = states[index % len(states)]
            sense = law.sense(sense, velocity)
            _, torque = law.offsets(q, velocity, acceleration, sense)
            law.excess(torque)
        times.append(1e6 * (time.thread_time() - begun) / (ROUNDS // 5))
    name = "both offsets of six axes, processor time per SYNC"
    return {name: figure(float(np.median(times)), "<= 100", "us", (min(times), max(times)))}


if __name__ == "__main__":
    raise SystemExit(main())
