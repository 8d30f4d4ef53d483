"""The tests that need no simulator, on every version of CPython that is supported and found on this computer.

python -m benchmarks.interpreters [--out out/interpreters]

The engine of the simulator (pybullet) has wheels for CPython 3.11 alone; `make test` runs there with all tests. An
interpreter is `python3.N` of the path, or one of pyenv. One that is not found is a missed goal, not a pass.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Final

from benchmarks.figure import figure, show

VERSIONS: Final = ("3.12", "3.13")
PACKAGES: Final = (
    *("cell", "commands", "data", "diagnose", "estimate", "excite", "feedforward", "fleet", "formats"),
    *("identify", "model", "newcell", "pipeline", "report", "result"),
)
#: Test modules that import the engine of the simulator.
WITH_ENGINE: Final = (
    "tests/drives/test_bus.py",
    "tests/gateway/diagnose/test_axes_count.py",
    "tests/gateway/commands/test_live.py",
    "tests/gateway/commands/test_profiles.py",
)
TOOLS: Final = (
    "pytest>=8",
    "pytest-timeout",
    "pytest-xdist",
    "hypothesis",
    "pin",
    "statsmodels",
    "jsonschema",
    "httpx",
)


def main(argv: list[str]) -> int:
    """Exit 1 where a test fails or an interpreter is missing."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.interpreters", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/interpreters"))
    out: Path = parser.parse_args(argv).out
    out.mkdir(parents=True, exist_ok=True)
    figures: dict[str, dict] = {}
    for version in VERSIONS:
        python = find_interpreter(version)
        failed, passed = (1, 0) if python is None else tested(python, out / version)
        figures[f"CPython {version}: found"] = figure(int(python is not None), "== 1")
        figures[f"CPython {version}: tests that fail"] = figure(failed, "== 0")
        figures[f"CPython {version}: tests that pass"] = figure(passed, ">= 1000")
    (out / "summary.json").write_text(json.dumps({"figures": figures}, indent=1) + "\n", encoding="utf-8")
    show(figures)
    return 0 if all(each["met"] for each in figures.values()) else 1


def find_interpreter(version: str) -> str | None:
    """The program of that version of CPython; None where there is none that runs."""
    versions = Path(os.environ.get("PYENV_ROOT", "~/.pyenv")).expanduser() / "versions"
    candidates = [shutil.which(f"python{version}"), *map(str, versions.glob(f"{version}.*/bin/python"))]
    code = f"import sys; sys.exit(sys.version_info[:2] != {tuple(map(int, version.split('.')))})"
    for candidate in filter(None, candidates):
        if subprocess.run([candidate, "-c", code], capture_output=True, check=False).returncode == 0:
            return candidate
    return None


def tested(python: str, folder: Path) -> tuple[int, int]:
    """Tests that fail and that pass in a new environment of that interpreter."""
    subprocess.run([python, "-m", "venv", "--clear", str(folder)], check=True)
    inside = str(folder / "bin" / "python")
    install = [inside, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "-c", "constraints.txt"]
    subprocess.run([*install, "-e", ".[formats,fleet]", *TOOLS], check=True)
    words = [f"tests/gateway/{package}" for package in PACKAGES] + ["tests/drives"]
    words += [f"--ignore={name}" for name in WITH_ENGINE]
    line = [inside, "-m", "pytest", "-o", "addopts=--strict-markers --import-mode=importlib", "-m", "not slow", *words]
    said = subprocess.run([*line, "-p", "no:cacheprovider"], capture_output=True, text=True, check=False).stdout
    (folder / "tests.log").write_text(said, encoding="utf-8")
    last = said.strip().splitlines()[-1] if said.strip() else ""
    counts = {word: int(number) for number, word in re.findall(r"(\d+) (passed|failed|error)", last)}
    return counts.get("failed", 0) + counts.get("error", 0), counts.get("passed", 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
