"""Drives of every known make, six on one simulated bus, from the data sheet to the estimated load; in lockstep.

python -m benchmarks.makes [--makes NAME,..] [--mixed] [--drawn N] [--store] [--jobs 2] [--out out/makes]

Each make is commissioned as an engineer does it: `profiles new` from the EDS and the answers of manual and motor plate,
`check`, `check --prove-stop`, `record` unloaded and loaded, `estimate`. With `--mixed` also arms of six makes each. N
drawn makes (`sim.makes.draw_make`) are checked and prove their stop; one of 40 measures the load as well. What a
refusal names is changed, and the step tried again. `--store` writes what became of each make beside this program, for
`docs/reference/drives.md`.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import tempfile
import uuid
from pathlib import Path
from typing import Any

from click.testing import CliRunner

from benchmarks.figure import conclude, figure, share
from benchmarks.program import one_thread, options, run
from drives.profile import Constant
from drives.profile_file import load_profile
from gateway.cli import main as program
from sim.fake_drive import FakeDrive
from sim.fault import Fault
from sim.faults import act
from sim.makes import QUIRKS, draw_make
from sim.serve import running
from tests.data.sheets import write_sheet
from tests.support.rigs.pacing import in_lockstep, measured_shortly

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "small"
STORED = Path(__file__).with_name("makes.json")
#: Makes without any torque or current word.
WEIGHS_NOTHING = ("trinamic",)
LOADS = ("none", "gripper")
HALF_WIDTH = 1.96
#: Answers of `profiles new` as messages name them; an object or a question that a refusal names before its remedy.
ANSWER = re.compile(r'(cyclic_mode|ignored_status|warning_codes) = "?(\w+)"?')
REASON = re.compile(r"(?s)error: .*([0-9A-F]{4}:[0-9A-F]{2}|0x[0-9A-F]{4}).*; \w")
#: Torque limit 0x6072 that is set where `check` refuses that of a drive as delivered [per mille].
RAISED = 3750
#: Joint motion that counts as moved; and that of an axis that drops during the proof of its stop [rad].
MOVED_RAD, DROP_RAD = 1e-4, 0.02


def answers(drive: FakeDrive) -> dict[str, Any]:
    """Answers to the questions of a profile draft: manual as in the packaged profile, motor plate as simulated."""
    profile, units = load_profile(str(drive.spec.profile["name"])), drive.units
    signal, counts, velocity = profile.torque, profile.position.counts_per_revolution, profile.velocity
    given: dict[str, Any] = {"torque_kind": signal.kind, "torque_nature": "measured", "torque_source": "manual"}
    given |= {"velocity_unit_rad_s": 1.0 / units.velocity.bits_per_unit, "lost_heartbeat": "quick stop"}
    given |= {"velocity_source": "manual", "position_source": "encoder data sheet"}
    if velocity is not None and velocity.ramp_counts_s2 is not None:
        given["ramp_counts_s2"] = velocity.ramp_counts_s2.value
    if signal.object.index != 0x6077:
        given["torque_object"] = f"0x{signal.object.index:04X}"
    if signal.is_current:
        given["current_reference"] = signal.current_reference or "rms"
        given["torque_constant_per"] = signal.torque_constant_per or "rms"
    if signal.internal_unit_a is not None:
        given["internal_unit_a"] = signal.internal_unit_a.value
    elif signal.rated is None or signal.rated.object is None:
        given["rated_value"] = units.rated_torque_nm if signal.rated is None else signal.rated.value
    else:
        address = f"0x{signal.rated.object.index:04X}:{signal.rated.object.subindex:02X}"
        given |= {"rated_object": address, "rated_unit": signal.rated.unit}
    if isinstance(counts, Constant):
        given["counts_per_revolution"] = counts.value
    elif counts.object.index != 0x608F:
        given["counts_object"] = f"0x{counts.object.index:04X}:{counts.object.subindex:02X}"
    return given


def commissioned(task: dict[str, Any]) -> dict[str, Any]:
    """Commission an arm of drives from their data sheets; what each step reported, and what the drives did.

    `task` holds its name; the makes, one for each axis; rows of `sim.faults.KINDS` beside theirs (`rows`). `in_sheet`:
    the data sheets show these rows. `can_move`: the drives have what a motion needs. `reads`: each drive
    is read for its profile. `measures`: the load is estimated.
    """
    steps: list[dict[str, Any]] = []
    changed, raised = dict[str, str](), set[str]()
    text = measured_shortly(in_lockstep((EXAMPLE / "cell.toml").read_text(encoding="utf-8")))
    text = text.replace("count = 6", "count = 4").replace("validation = 2", "validation = 0")
    bus = f"virtual:makes-{uuid.uuid4().hex}"

    def step(*words: object) -> bool:
        done = CliRunner().invoke(program, [str(word) for word in words])
        crash = "" if isinstance(done.exception, SystemExit | None) else f"crash: {done.exception!r}"
        steps.append({"step": str(words[0]), "exit": done.exit_code, "said": crash or done.output})
        return done.exit_code == 0

    def write_cell(path: Path, profiles: list[str]) -> Path:
        left = iter(profiles)
        cell = re.sub(r'(?m)^profile = ".*"$', lambda _: f'profile = "{next(left)}"', text)
        path.write_text(cell, encoding="utf-8")
        return path

    def prepared() -> bool:
        """Draft a profile for each make and motor, check the cell, prove the stop."""
        names: dict[str, str] = {}
        for drive, make, sheet in zip(drives, task["makes"], sheets, strict=True):
            key = make + "".join(f"\n{key} = {json.dumps(value)}" for key, value in answers(drive).items())
            if key not in names:
                file = folder / f"mine-{drive.node_id}.answers"
                file.write_text(key.removeprefix(make), encoding="utf-8")
                file.with_suffix(".toml").unlink(missing_ok=True)
                words = ["--eds", sheet, "--answers", file, "-o", file.with_suffix(".toml")]
                words += [word for each in changed.items() for word in ("--answer", "=".join(each))]
                words += ["--from-drive", drive.node_id, "--bus", bus] if task["reads"] else []
                if not step("profiles", "new", *words):
                    return False
                names[key] = file.stem
            named.append(names[key])
        on = (write_cell(folder / "cell.toml", named[-6:]), "--bus", bus)
        return step("check", *on) and step("check", *on, "--prove-stop", "--yes")

    def follow() -> bool:
        """Do what the last refusal names; false where that was done before, or nothing can be done."""
        before = dict(changed)
        changed.update(ANSWER.findall(steps[-1]["said"]))
        weak = [each for each in drives if "6072:00" in steps[-1]["said"] and each.store.number((0x6072, 0)) < RAISED]
        for drive in weak:
            act([drive], Fault("object_value", index=0x6072, code=RAISED))
            raised.add("0x6072 raised")
        return bool(weak) or before != changed

    with tempfile.TemporaryDirectory() as name:
        folder, named, off_std = Path(name), list[str](), None
        os.environ["XDG_STATE_HOME"] = str(folder / "state")
        for file in ("robot.urdf", "payload.toml"):
            shutil.copy(EXAMPLE / file, folder)
        served, payload = write_cell(folder / "served.toml", task["makes"]), folder / "payload.toml"
        with running(served, bus, payload=payload, pacing="lockstep") as handle:
            drives = handle.simulation.arms[0].drives
            for row in task["rows"] * task["in_sheet"]:
                act(drives, row)
            sheets = [write_sheet(drive, folder / f"{drive.node_id}.eds") for drive in drives]
            for row in task["rows"] * (not task["in_sheet"]):
                act(drives, row)
            began = [drive.axis.position_rad for drive in drives]
            passed = prepared()
            while not passed and follow():
                passed = prepared()
            ended = [drive.axis.position_rad for drive in drives]
            runs = {load: folder / f"{load}.h5" for load in LOADS * task["measures"]}
            for load, path in runs.items():
                handle.mount(load)
                on = (folder / "cell.toml", "--bus", bus, "--load", load, "-o", path, "--yes")
                passed = passed and step("record", *on)
            if runs and passed and (passed := step("estimate", *runs.values(), "--json", folder / "result.json")):
                (load,) = json.loads((folder / "result.json").read_text(encoding="utf-8"))["loads"]
                off_std = abs(load["mass_kg"] - handle.simulation.loads[LOADS[1]].mass_kg) / load["mass_std_kg"]
            powered = any(drive.automaton.energised for drive in drives)
    moved_rad = max(abs(a - b) for a, b in zip(began, ended, strict=True))
    refused = "" if passed else re.sub(r"\b\d\.eds", "the EDS", steps[-1]["said"].split("error: ")[-1].strip())
    did = [*(f"{key} = {value}" for key, value in changed.items()), *raised]
    outcome = {"name": task["name"], "passed": passed, "refused": refused, "changed": did, "off_std": off_std}
    return outcome | {"can_move": task["can_move"], "powered": powered, "moved_rad": moved_rad, "steps": steps}


def judged(runs: list[dict[str, Any]], kind: str) -> dict[str, dict]:
    """Figures of the arms of a kind."""
    unsafe = [run for run in runs if run["powered"] or run["moved_rad"] > (DROP_RAD if run["can_move"] else MOVED_RAD)]
    unnamed = [run for run in runs if not run["passed"] and not REASON.search(run["steps"][-1]["said"])]
    able = [run for run in runs if run["can_move"]]
    off = [run["off_std"] < HALF_WIDTH for run in runs if run["off_std"] is not None]
    return {
        f"{kind}: arms": figure(len(runs)),
        f"{kind}: left powered, dropped, or moved when it must not": figure(len(unsafe), "== 0"),
        f"{kind}: refused without a reason": figure(len(unnamed), "== 0"),
        f"{kind}: refused, although it has every object": share([not run["passed"] for run in able], "<= 0.02"),
        f"{kind}: changed, as a message named it": share([bool(run["changed"]) for run in able]),
        f"{kind}: load inside its 95 % interval": share(off, ">= 0.94"),
    }


def main(argv: list[str] | None = None) -> int:
    """Exit 1 when a goal is missed."""
    parser = options(__doc__, "out/makes", jobs=2)
    parser.add_argument("--makes", default=",".join(QUIRKS), help="names, separated by commas; all by default")
    parser.add_argument("--mixed", action="store_true")
    parser.add_argument("--drawn", type=int, default=0)
    parser.add_argument("--store", action="store_true")
    arguments = parser.parse_args(argv)
    base = {"rows": (), "in_sheet": True, "can_move": True, "reads": False, "measures": True}
    names = [name for name in arguments.makes.split(",") if name]
    able = [name for name in names if name not in WEIGHS_NOTHING]
    tasks = {"makes": [base | {"name": name, "makes": [name] * 6, "can_move": name in able} for name in names]}
    sixes = [[able[(first + axis) % len(able)] for axis in range(6)] for first in range(0, len(able), 6)]
    mixed = [base | {"name": " ".join(six), "makes": six, "reads": True} for six in sixes]
    tasks["mixed"] = mixed if arguments.mixed else []
    tasks["drawn"] = []
    for seed in range(arguments.drawn):  # every second data sheet promises what the drive lacks
        drawn = dict(zip(("rows", "can_move"), draw_make(seed), strict=True)) | {"makes": ["generic-cia402"] * 6}
        drawn |= {"name": f"drawn {seed}", "in_sheet": seed % 2 == 0, "reads": True, "measures": seed % 40 == 0}
        tasks["drawn"].append(base | drawn)
    figures: dict[str, dict] = {}
    for kind in (kind for kind in tasks if tasks[kind]):
        runs = run(commissioned, tasks[kind], arguments.jobs, arguments.out / f"{kind}.jsonl")
        figures |= judged(runs, kind)
        if kind == "makes" and arguments.store:
            kept = {
                each["name"]: "load measured" + "".join(f", after `{change}`" for change in each["changed"])
                if each["passed"]
                else f"refused: {each['refused']}"
                for each in runs
            }
            STORED.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
    return conclude(figures, arguments.out)


if __name__ == "__main__":
    one_thread()
    raise SystemExit(main())
