"""The counter of faults: typed errors pass, anything else is counted; the inputs are the same every time."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from benchmarks.strangers import hostile
from gateway.errors import InputError


def _fails(path: Path) -> None:
    if path.stat().st_size:
        raise InputError("a typed error")


def _crashes(_path: Path) -> None:
    raise KeyError("x")


@pytest.mark.parametrize(
    ("read", "kinds"), [(_fails, []), (_crashes, ["crash"] * 3), (lambda path: path.read_bytes(), [])]
)
def test_untyped_errors_are_counted(tmp_path: Path, monkeypatch, capsys, read, kinds) -> None:
    calls = iter(range(10))
    monkeypatch.setitem(
        hostile.READERS,
        "one",
        lambda: ("one.txt", [b"seed"], lambda path: None if next(calls) == 0 else read(path)),  # the first is the seed
    )
    (tmp_path / "in").mkdir()
    (tmp_path / "cwd").mkdir()
    monkeypatch.chdir(tmp_path)
    hostile.work("one", 0, 3, tmp_path)
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line for line in lines if isinstance(line, int)] == [0, 1, 2]
    assert [line[0] for line in lines if isinstance(line, list)] == kinds
    assert Path(os.getcwd()) == tmp_path / "cwd"
