"""Logs of strangers: runs of one arm at rest and in motion, written as other programs write them.

A log counts as right when it is imported as written, with the load of the table inside its interval. It also counts as
right when it is refused with its line and a remedy. Values come from pinocchio. The runs are those whose plain
table holds the load inside its interval, so that only the layout is judged.
"""

from __future__ import annotations

import csv
import io
import json
import re
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
from click.testing import CliRunner

from benchmarks.figure import figure
from gateway.cli import main
from tests.data.mounted import readings
from tests.data.moving_arm import URDF, World, measured

LAYOUTS = 200
POSES = 12
#: A run in motion is one of so many layouts: it costs several seconds.
ONE_MOVING_OF = 10
#: 95 % of a normal distribution, and of the largest of four.
_WITHIN = 2.5


@dataclass(frozen=True)
class Run:
    """What was measured: columns t, load, q1.., m1.. in SI, and the load."""

    time_s: np.ndarray
    load: list[str]
    q_rad: np.ndarray
    tau_nm: np.ndarray
    pose: np.ndarray | None
    truth: np.ndarray


@dataclass
class Layout:
    """A log as it is written, the map for it, and what becomes of it."""

    rows: list[list[str]]
    settings: dict[str, str] = field(default_factory=dict)
    separator: str = ","
    encoding: str = "utf-8"
    bom: bytes = b""
    end: str = "\n"
    before: list[str] = field(default_factory=list)
    refused: str = ""
    odd: list[str] = field(default_factory=list)


@cache
def rest_run(seed: int) -> Run:
    """Poses approached from both sides, unloaded and loaded."""
    rng = np.random.default_rng([seed, 11])
    truth = np.array([rng.uniform(1.0, 5.0), *rng.uniform(-0.08, 0.08, 2), rng.uniform(0.03, 0.2)])
    q, tau, load, pose = [], [], [], []
    places = rng.uniform(-1.3, 1.3, (POSES, 6))
    mass, *com = truth.tolist()
    for label, payload in (("none", None), ("tool", (mass, com[0], com[1], com[2]))):
        for number, _, torque in readings(seed, rng, places, [payload] * POSES):
            q.append(places[number - 1])
            tau.append(torque)
            load.append(label)
            pose.append(number)
    return Run(2.0 * np.arange(len(q)), load, np.array(q), np.array(tau), np.array(pose), truth)


@cache
def moving_run(seed: int) -> Run:
    """A motion with the load."""
    truth = np.array([3.2, 0.05, 0.02, 0.09])
    table = measured([seed, 1], World(payload=tuple(truth)), 10.0, 50.0, arm_seed=seed)[0]
    times = 0.02 * np.arange(len(table.time_s))
    return Run(times, ["tool"] * len(times), table.q_rad, table.tau_nm, None, truth)


def number_text(rng: np.random.Generator) -> tuple[str, Callable[[float], str]]:
    """A notation of numbers."""
    forms = {
        "all digits": repr, "nine decimals": lambda value: f"{value:.9f}", "exponents": lambda value: f"{value:.10e}",
        "a plus": lambda value: f"{value:+.9f}",
    }  # fmt: skip
    name = str(rng.choice(list(forms)))
    return name, forms[name]


def draw(seed: int) -> tuple[Layout, Run]:
    """A layout and its run."""
    rng = np.random.default_rng([seed, 5])
    moving = seed % ONE_MOVING_OF == 0
    run = moving_run(sound(True)[0]) if moving else rest_run(sound(False)[seed % len(sound(False))])
    odd: list[str] = ["moving" if moving else "at rest"]
    angle, torque, clock = str(rng.choice(["rad", "deg", "mrad"])), str(rng.choice(["Nm", "mNm", "kNm", "%"])), "s"
    factor = {"rad": 1.0, "deg": 180 / np.pi, "mrad": 1e3}[angle]
    rated = np.round(rng.uniform(20, 200, 6), 1)
    sign = rng.choice([-1, 1], 6)
    scale = {"Nm": np.ones(6), "mNm": np.full(6, 1e3), "kNm": np.full(6, 1e-3), "%": 100 / rated}[torque]
    stamps = run.time_s.copy()
    if moving and rng.random() < 0.7:
        scatter = float(rng.choice([0.0005, 0.0045]))
        odd.append(f"stamps scatter by {scatter} s")
        stamps = stamps + rng.uniform(-scatter, scatter, len(stamps))
    form_name, form = number_text(rng)
    odd += [angle, torque, form_name]
    first = int(rng.choice([0, 1]))
    joint = str(rng.choice(["q{}", "joint_{}/position", "A{} act", "pos[{}]"]))
    effort = str(rng.choice(["m{}", "joint_{}/effort", "M{} act", "eff[{}]"]))
    kind = str(rng.choice(["s", "ms", "us", "iso", "iso zone", "day"])) if not moving else str(rng.choice(["s", "ms"]))
    odd.append(f"time {kind}")
    if kind in ("s", "ms", "us"):
        clock = kind
        base = float(rng.choice([0.0, 1000.0]))
        time_cells = [form(base + value * {"s": 1.0, "ms": 1e3, "us": 1e6}[kind]) for value in stamps.tolist()]
    else:
        zone = {"iso": "", "iso zone": "+02:00", "day": ""}[kind]
        day = "" if kind == "day" else f"2026-05-1{rng.integers(0, 9)}{rng.choice(['T', ' '])}"
        time_cells = [f"{day}08:{int(t // 60):02d}:{t % 60:06.3f}{zone}" for t in stamps.tolist()]
    names = [
        "stamp",
        *(joint.format(axis + first) for axis in range(6)),
        *(effort.format(axis + first) for axis in range(6)),
    ]
    units = [clock, *([angle] * 6), *([torque] * 6)]
    cells = [
        [at, *(form(float(v)) for v in factor * sign * q), *(form(float(v)) for v in scale * sign * tau)]
        for at, q, tau in zip(time_cells, run.q_rad, run.tau_nm, strict=True)
    ]
    names, units = [*names, "tool"], [*units, ""]
    cells = [[*row, label] for row, label in zip(cells, run.load, strict=True)]
    if run.pose is not None:
        names, units = [*names, "point"], [*units, ""]
        cells = [[*row, str(number)] for row, number in zip(cells, run.pose.tolist(), strict=True)]
    layout = Layout([], odd=odd)
    layout.settings = {
        "angle": angle, "torque": torque, "clock": clock, "first": str(first), "joint": joint, "effort": effort,
        "sign": json.dumps(sign.tolist()), "rated": json.dumps(rated.tolist()), "moving": "y" if moving else "",
    }  # fmt: skip
    dress(layout, rng, names, units, cells)
    if rng.random() < 0.25:
        spoil(layout, rng)
    return layout, run


def dress(layout: Layout, rng: np.random.Generator, names: list[str], units: list[str], cells: list[list[str]]) -> None:
    """Put on what programs put around the numbers."""
    order = rng.permutation(len(names)) if rng.random() < 0.4 else np.arange(len(names))
    names, units = [names[i] for i in order], [units[i] for i in order]
    cells = [[row[i] for i in order] for row in cells]
    if rng.random() < 0.3:
        layout.odd.append("further columns")
        names, units = [*names, "state", ""], [*units, "", ""]
        cells = [[*row, "RUN", ""] for row in cells]
    layout.separator = str(rng.choice([",", ";", "\t"]))
    style = rng.choice(["point", "comma", "thousands"], p=[0.5, 0.3, 0.2]) if layout.separator != "," else "point"
    if style != "point":
        layout.odd.append(f"decimal {style}")
        cells = [[european(cell, style == "thousands") for cell in row] for row in cells]
    if rng.random() < 0.4:
        layout.odd.append("units row")
        brackets = rng.choice(["{}", "[{}]", "({})"])
        cells = [[brackets.format(unit) if unit else "" for unit in units], *cells]
    layout.rows = [names, *cells]
    if rng.random() < 0.3:
        layout.odd.append("separators at the end")
        layout.rows = [[*row, ""] for row in layout.rows]
    if rng.random() < 0.4:
        layout.odd.append("lines above")
        layout.before = ["Trace 12 May 2026", "", "Robot: cell 4"][: int(rng.integers(1, 4))]
    if rng.random() < 0.3:
        layout.odd.append("comments")
        layout.before.append("# written by a logger")
        layout.rows.insert(int(rng.integers(2, len(layout.rows))), ["# event"])
    form = str(rng.choice(["utf-8", "mark", "utf-16", "utf-16-le", "latin-1"], p=[0.5, 0.15, 0.15, 0.1, 0.1]))
    layout.odd.append(form)
    layout.encoding, layout.bom = ("utf-8", b"\xef\xbb\xbf") if form == "mark" else (form, b"")
    if form == "latin-1":
        layout.before.append("Grö\N{LATIN SMALL LETTER SHARP S}e")
        layout.settings["encoding"] = "latin-1"
    layout.end = str(rng.choice(["\n", "\r\n"]))


def european(cell: str, thousands: bool) -> str:
    """A number with a decimal comma; other cells as they are."""
    if not re.fullmatch(r"[-+]?\d+\.\d+(e[-+]\d+)?", cell):
        return cell
    if thousands and "e" not in cell:
        digits, _, rest = cell.partition(".")
        mark = digits[0] if digits[0] in "+-" else ""
        return f"{mark}{int(digits.lstrip('+-')):,}".replace(",", ".") + "," + rest
    return cell.replace(".", ",")


def spoil(layout: Layout, rng: np.random.Generator) -> None:
    """Make one thing wrong, and say what has to be named: the line, or what to do."""
    body = 2 + layout.rows[1].count("")
    row = int(rng.integers(max(body, 4), len(layout.rows) - 1))
    while layout.rows[row][0].startswith("#") or layout.rows[row - 1][0].startswith("#"):
        row -= 1
    line = len(layout.before) + row + 1
    names = layout.rows[0]
    angle = next(i for i, name in enumerate(names) if name == layout.settings["joint"].format(layout.settings["first"]))
    stamp = names.index("stamp")
    kinds = ["nan", "empty", "text", "time back", "short", "long", "missing", "twice", "label"]
    kind = str(rng.choice(kinds))
    layout.odd.append(f"SPOILT: {kind}")
    if kind in ("nan", "empty", "text"):
        layout.rows[row][angle] = {"nan": "nan", "empty": "", "text": "n/a"}[kind]
        layout.refused = rf":{line}: .*exclude the row with \[rows\]"
    elif kind == "time back":
        layout.rows[row][stamp] = layout.rows[row - 2][stamp]
        layout.refused = rf":{line}: .*time (goes back|stands still).*cut the log there"
    elif kind == "short":
        layout.rows[row] = layout.rows[row][:5]
        layout.refused = rf":{line}: 5 cells where the header names \d+ columns; see separator"
    elif kind == "long":
        layout.rows[row] = [*layout.rows[row], "7"]
        layout.refused = rf":{line}: \d+ cells where the header names \d+ columns; "
    elif kind == "missing":
        layout.rows[0][angle] = "other"
        layout.refused = r":\d+: column '.*', which the map names, is missing; the log holds "
    elif kind == "twice":
        layout.rows[0].append(layout.rows[0][angle])
        layout.rows[1:] = [[*each, "0"] for each in layout.rows[1:]]
        layout.refused = r":\d+: column '.*' is given twice"
    else:
        layout.rows[row][names.index("tool")] = "empty"
        layout.refused = rf":{line}: .*denotes the unloaded arm: write none"


def written(layout: Layout) -> bytes:
    """Bytes of the log."""
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, delimiter=layout.separator, lineterminator=layout.end, quoting=csv.QUOTE_MINIMAL)
    for line in layout.before:
        stream.write(line + layout.end)
    for row in layout.rows:
        writer.writerow(row)
    return layout.bom + stream.getvalue().encode(layout.encoding)


def map_of(layout: Layout) -> str:
    """The map that a person would write: names, units, signs; how the text is written is left to the reader."""
    about = layout.settings
    lines = ["axes = 6"]
    if "encoding" in about:
        lines += ["[log]", f'encoding = "{about["encoding"]}"']
    lines += ["[time]", 'column = "stamp"', f'unit = "{about["clock"]}"', "[load]", 'column = "tool"']
    if about["moving"]:
        lines += ["[motion]", "cutoff_hz = 10"]
    else:
        lines += ["[[column]]", 'log = "point"', 'table = "pose"', 'unit = "1"']
    for log, table, unit in (
        (about["joint"], "q{}_rad", about["angle"]),
        (about["effort"], "tau{}_nm", about["torque"]),
    ):
        lines += ["[[column]]", f"log = '{log}'", f'table = "{table}"', f'unit = "{unit}"']
        lines += [f"first = {about['first']}", f"sign = {about['sign']}"]
        lines += [f"rated = {about['rated']}"] if unit == "%" else []
    return "\n".join(lines) + "\n"


def command(*words: object) -> tuple[int, str]:
    """Exit code and message of a command of the gateway."""
    done = CliRunner().invoke(main, list(map(str, words)))
    return done.exit_code, " ".join(done.stderr.split())


def load_inside(folder: Path, table: Path, truth: np.ndarray) -> str:
    """Why the load of a table is not inside its interval; empty where it is."""
    code, said = command("estimate", table, "--robot", folder / "robot.urdf", "--inertials", "prior:0.05",
                         "--json", folder / "r.json")  # fmt: skip
    if code:
        return f"estimate: {code} {said}"
    load = next(each for each in json.loads((folder / "r.json").read_text())["loads"] if each["label"] == "tool")
    found = np.array([load["mass_kg"], *load["com_m"]])
    std = np.array([load["mass_std_kg"], *load["com_std_m"]])
    return "" if (np.abs(found - truth) < _WITHIN * std).all() else f"{found} +- {std} for {truth}"


@cache
def sound(moving: bool) -> tuple[int, ...]:
    """Seeds of runs whose plainly written table holds the load inside its interval."""
    found: list[int] = []
    for seed in range(20):
        run = moving_run(seed) if moving else rest_run(seed)
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            (folder / "robot.urdf").write_text(URDF)
            columns = ["tool", *(f"q{i}" for i in range(1, 7)), *(f"m{i}" for i in range(1, 7)), "point"]
            pose = np.zeros(len(run.time_s), int) if run.pose is None else run.pose
            rows = zip(
                run.time_s.tolist(), run.load, run.q_rad.tolist(), run.tau_nm.tolist(), pose.tolist(), strict=True
            )
            cells = [[repr(t), load, *map(repr, q), *map(repr, m), str(p)] for t, load, q, m, p in rows]
            plain = Layout([["stamp", *columns], *cells])
            plain.settings = {
                "angle": "rad", "torque": "Nm", "clock": "s", "first": "1", "joint": "q{}", "effort": "m{}",
                "sign": "1", "rated": "", "moving": "y" if moving else "",
            }  # fmt: skip
            (folder / "log.csv").write_bytes(written(plain))
            (folder / "map.toml").write_text(map_of(plain))
            code, said = command("import", folder / "log.csv", "--map", folder / "map.toml", "-o", folder / "t.csv")
            if code:
                raise SystemExit(f"the plain log is refused: {said}")
            if not load_inside(folder, folder / "t.csv", run.truth):
                found.append(seed)
        if len(found) == (1 if moving else 8):
            break
    return tuple(found)


def judge(layout: Layout, run: Run, folder: Path) -> str:
    """Why a layout was not handled; empty where it was."""
    (folder / "log.csv").write_bytes(written(layout))
    (folder / "map.toml").write_text(map_of(layout))
    (folder / "robot.urdf").write_text(URDF)
    code, said = command("import", folder / "log.csv", "--map", folder / "map.toml", "-o", folder / "t.csv")
    if layout.refused:
        return "" if code == 3 and re.search(layout.refused, said) else f"not refused as expected: {code} {said}"
    if code:
        return f"refused: {said}"
    with (folder / "t.csv").open(newline="") as stream:
        table = list(csv.DictReader(stream))
    for name, wanted in (("q{}_rad", run.q_rad), ("tau{}_nm", run.tau_nm)):
        found = np.array([[float(row[name.format(axis)]) for axis in range(1, 7)] for row in table])
        if found.shape != wanted.shape or np.abs(found - wanted).max() > 1e-6:
            return f"{name} is not what was written"
    return load_inside(folder, folder / "t.csv", run.truth)


def figures() -> dict[str, dict]:
    """Figures of all layouts; what is not handled right is said on stderr."""
    handled = read = 0
    seconds = [0.0]
    for seed in range(LAYOUTS):
        with tempfile.TemporaryDirectory() as folder:
            layout, run = draw(seed)
            began_s = time.process_time()
            try:
                why = judge(layout, run, Path(folder))
            except Exception as failed:  # a crash is a miss like any other
                why = f"{type(failed).__name__}: {failed}"
            seconds.append(time.process_time() - began_s)
        if why:
            print(f"log {seed} ({', '.join(layout.odd)}): {why}", file=sys.stderr, flush=True)
        handled += not why
        read += not layout.refused and not why
    return {
        "logs: layouts": figure(LAYOUTS, f">= {LAYOUTS}"),
        "logs: share imported with the load inside its interval, or refused with line and remedy": figure(
            100.0 * handled / LAYOUTS, "== 100", unit="%"
        ),
        "logs: imported": figure(read, ">= 1"),
        "logs: slowest, import and estimate, processor time": figure(max(seconds), "<= 30", unit="s"),
    }
