"""Promises of what a pair reads: its cell, the path of the part, taught points, functions, runs for the report."""

from __future__ import annotations

import csv
import io
import json
import shutil
from functools import cache
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

from benchmarks.fuzz.check_files import EXAMPLES, WORK, in_file
from benchmarks.fuzz.guard import bounded
from benchmarks.fuzz.mutate import damaged
from drives.errors import BusError
from gateway.errors import ConfigError, InputError
from gateway.pair.pair_cell import COLUMNS, PairCell, load_pair, read_path
from gateway.pair.pair_store import PairStore
from gateway.pair.teach import TaughtPath, read_taught_path, taught_point
from gateway.pair.transform_function import TransformFunction, function_of_knots, transform_of
from gateway.report.pair_page import FORCE, Limited, render_pair
from gateway.result.values import json_text

PAIR = EXAMPLES / "pair"


@cache
def _folder() -> Path:
    """The example pair, with room for a cell file that is changed."""
    folder = Path(WORK.name) / "pair"
    shutil.copytree(PAIR, folder)
    return folder


@cache
def _cell() -> PairCell:
    return load_pair(PAIR / "cell.toml")


@cache
def _store() -> PairStore:
    folder = Path(WORK.name) / "store"
    folder.mkdir()
    return PairStore(_cell(), folder)


# ---------------------------------------------------------------------------------------------------------- cell, path


def cells() -> st.SearchStrategy[bytes]:
    """Cell files of a pair, most of them changed inside [pair]."""
    text = (PAIR / "cell.toml").read_bytes()
    begin = text.index(b"[pair]")
    end = text.index(b"[[arm]]", begin)
    table = damaged([text[begin:end]]).map(lambda part: text[:begin] + part + text[end:])
    return st.one_of(table, table, damaged([text]))


def check_cell(data: bytes) -> None:
    """Two arms and a path whose commands are finite, or a typed error."""
    path = _folder() / "changed.toml"
    path.write_bytes(data)
    size = len(data) + (PAIR / "path.csv").stat().st_size + 2 * (PAIR / "robot.urdf").stat().st_size
    cell = bounded(lambda: load_pair(path), (ConfigError, InputError, BusError), size)
    if cell is None:
        return
    assert cell.program.dt_s > 0
    path_ = bounded(lambda: cell.path(), (InputError,), size)
    if path_ is not None:
        assert np.isfinite(path_.commands).all()
        assert (np.diff(path_.s_m) >= 0).all()
        assert len(PairStore(cell, _folder()).cell_hash) == 64
        bounded(lambda: path_.uniform(cell.config.knots), (InputError,), size)


def paths() -> st.SearchStrategy[bytes]:
    lines = (PAIR / "path.csv").read_bytes().splitlines(keepends=True)
    return damaged([b"".join(lines[:12]), b"".join(lines[:4])])


def check_path(data: bytes) -> None:
    """Every pose as it is in the file, or `InputError`."""
    path = in_file(data, "part.csv")
    read = bounded(lambda: read_path(path), (InputError,), len(data))
    if read is None:
        return
    poses, step_s = read
    rows = list(csv.DictReader(io.StringIO(data.decode(), newline="")))
    places = [[float(row[name]) for name in COLUMNS[1:4]] for row in rows]
    times = [float(row["time_s"]) for row in rows]
    assert np.array_equal(poses[:, :3, 3], places)
    turn = poses[:, :3, :3]
    assert np.allclose(turn @ turn.transpose(0, 2, 1), np.eye(3), atol=1e-9)
    assert np.isclose(step_s * (len(rows) - 1), times[-1] - times[0])


# -------------------------------------------------------------------------------------------------- points, functions


def _function() -> TransformFunction:
    one, other = _cell().nominal_relation, _cell().nominal_relation
    other[:3, 3] += 1e-3
    return function_of_knots([0.0, 0.2, 0.5], np.array([one, other, one]))


def functions() -> st.SearchStrategy[bytes]:
    store = _store()
    seeds = []
    for stage in ("first", "second"):
        path = store.save(stage, _function(), learn_source="taught", speed=0.5, embodiment="C8", cycles=3)
        seeds.append(path.read_bytes())
        path.unlink()
    return damaged(seeds)


def check_function(data: bytes) -> None:
    """A function of rotations that is written and read back the same, or `InputError`."""
    store = _store()
    path = store.folder / "first.json"
    path.write_bytes(data)
    stored = bounded(lambda: store.load("first"), (InputError,), len(data))
    if stored is not None:
        function = transform_of(stored)
        assert np.isfinite(function.many(np.linspace(-1.0, 2.0, 7))).all()
        path.write_text(json_text(stored), encoding="utf-8")
        again = store.load("first")
        assert again is not None
        assert json_text(again) == json_text(stored)


def taught_paths() -> st.SearchStrategy[bytes]:
    store, function = _store(), _function()
    points = [
        taught_point(number * 10, 0.2 * number, function.at(0.2 * number), np.full(6, 1e-4), ((9.0, 3.0), (1.0, 0.5)))
        for number in range(3)
    ]
    return damaged([TaughtPath(store.path_hash, store.cell_hash, points).to_json().encode()])


def check_taught_path(data: bytes) -> None:
    """Points that a function goes through and that are written and read back the same, or `InputError`."""
    store, start = _store(), _cell().nominal_relation
    path = in_file(data, "points.json")

    def read() -> TaughtPath:
        taught = read_taught_path(path, store.path_hash, store.cell_hash)
        assert np.isfinite(taught.function(start).many([0.0, 0.1])).all()
        return taught

    taught = bounded(read, (InputError,), len(data))
    if taught is not None:
        path.write_text(taught.to_json(), encoding="utf-8")
        assert read_taught_path(path, store.path_hash, store.cell_hash).to_json() == taught.to_json()
        assert all(isinstance(point.command, int) and point.command >= 1 for point in taught.points)


# ------------------------------------------------------------------------------------------------- switch, runs, report


def states() -> st.SearchStrategy[bytes]:
    return damaged([b'{"frozen": true}\n'])


def check_state(data: bytes) -> None:
    """Learning on or off, or `InputError`."""
    store = _store()
    (store.folder / "state.json").write_bytes(data)
    assert bounded(lambda: store.frozen, (InputError,), len(data)) in (None, True, False)


def runs() -> st.SearchStrategy[bytes]:
    lengths = np.linspace(0.0, 0.5, 20)
    run = {
        "name": "C8",
        "text": "learned on the run",
        "speed": 1.0,
        "s_m": lengths.tolist(),
        "x_m": (0.9 + 0.1 * lengths).tolist(),
        "first_n": (30.0 * np.sin(9.0 * lengths)).round(2).tolist(),
        "last_n": (5.0 * np.sin(9.0 * lengths)).round(2).tolist(),
        "knots_s_m": [0.0, 0.25, 0.5],
        "cycles": [{"force_n": 30.0, "moment_nm": 2.0, "knots": 9}, {"force_n": 5.0, "moment_nm": None, "knots": 12}],
    }
    return damaged([json.dumps(run).encode()])


def check_run(data: bytes) -> None:
    """A page without a number that is none, or `InputError`."""
    store = _store()
    (store.folder / "run-C8.json").write_bytes(data)

    def read() -> str:
        rows = store.runs()
        return render_pair("pair", Limited(FORCE, 40.0, "torques"), rows) if rows else ""

    page = bounded(read, (InputError,), len(data))
    assert page is None or page.encode() is not None
