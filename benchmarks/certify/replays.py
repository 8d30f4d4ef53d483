"""Stored measurements, computed again by a program of its own with other processor kernels and threads."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.cell_file import invoked, write_cell_file
from benchmarks.conflict.answers import write_cell
from benchmarks.conflict.plant import draw_cell, measure

#: Two threads; and linear algebra without the vector units of this processor, which rounds as another computer does.
PLACES = {
    "two threads": {"OPENBLAS_NUM_THREADS": "2", "OMP_NUM_THREADS": "2"},
    "other kernels": {"OPENBLAS_CORETYPE": "Nehalem", "OPENBLAS_NUM_THREADS": "2", "OMP_NUM_THREADS": "2"},
}


def replayed(seed: int) -> dict:
    """Store a measurement, every fifth a diagnosis, and count what differs when it is computed again."""
    drawn = draw_cell(seed)
    answer: dict = {"seed": seed, "command": "diagnose" if seed % 5 == 4 else "estimate"}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_cell_file(folder, drawn.arm.rated_kg, drawn.arm.geometry.limit_rad, 10.0 * drawn.size_nm)
        drawn.columns = measure(drawn)
        table, _ = write_cell(drawn, folder)
        archive = folder / "stored.zip"
        code, said = invoked(answer["command"], table, "--cell", folder / "cell.toml", "--archive", archive)
        if not archive.exists():
            return answer | {"said": f"{code} {said[-200:]}"}
        for number, (place, changes) in enumerate(PLACES.items()):
            listed = folder / f"answer{number}.json"
            words = [sys.executable, "-m", "gateway.cli", "replay", str(archive), "--json", str(listed)]
            done = subprocess.run(words, capture_output=True, text=True, check=False, env={**os.environ, **changes})
            if not listed.exists():
                return answer | {"said": done.stderr[-200:]}
            answer[place] = json.loads(listed.read_text(encoding="utf-8"))["differences"]
    return answer


def replay_figures(replays: list[dict]) -> dict[str, dict]:
    """Measurements of which a value differs; of the loads alone too."""
    from benchmarks.figure import figure

    found = {}
    for place in PLACES:
        lists = [replay.get(place) for replay in replays]
        loads = sum(each is None or any(row["where"].startswith("loads") for row in each) for each in lists)
        replayed_count = sum(each is None or bool(each) for each in lists)
        found[f"replay, {place}: of {len(replays)} measurements, differ beyond 1e-9"] = figure(replayed_count, "== 0")
        found[f"replay, {place}: of {len(replays)} measurements, loads differ beyond 1e-9"] = figure(loads, "== 0")
    return found
