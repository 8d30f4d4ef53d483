"""The tutorial `your own robot`, typed as it is: each command of the page works, the estimated load is the mounted one.

The port of the bus is another one, since tests run beside each other.
"""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from sim.cellfile import read_payloads
from sim.serve import free_bus, wait_until_ready
from tests.system.conftest import command

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "tutorial" / "your-own-robot.md"
PORT = "43117"
_BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Block:
    """Text between fences: kind "" is typed in a terminal, `sim` in that of the simulator, `toml` is a file."""

    kind: str
    lines: tuple[str, ...]


def blocks(text: str) -> list[Block]:
    """All blocks of a page."""
    return [Block(kind, tuple(body.strip().splitlines())) for kind, body in _BLOCK.findall(text)]


@contextmanager
def simulator(words: list[str]) -> Iterator[subprocess.Popen[str]]:
    """`servo-sim` in a process of its own."""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = subprocess.Popen([sys.executable, "-m", "sim", *words[1:]], **pipes, text=True)
    try:
        wait_until_ready(process)
        yield process
    finally:
        process.terminate()
        process.communicate(timeout=20)


@pytest.mark.slow
def test_the_page_as_it_is_typed(tmp_path, monkeypatch):
    port = free_bus().rpartition("=")[2]
    shutil.copytree(ROOT / "examples" / "own", tmp_path / "examples" / "own")
    bench = tmp_path / "examples" / "own" / "bench" / "cell.toml"
    bench.write_text(bench.read_text(encoding="utf-8").replace(PORT, port), encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out" / "own").mkdir(parents=True)
    typed = []
    with ExitStack() as stack:
        drives = None
        for block in blocks(PAGE.read_text(encoding="utf-8").replace(PORT, port)):
            if block.kind == "toml":
                Path(block.lines[0].removeprefix("# ")).write_text("\n".join(block.lines), encoding="utf-8")
                continue
            for line in block.lines:
                words = shlex.split(line)
                if block.kind == "sim":
                    print(line, file=drives.stdin, flush=True)
                    assert "on the flange" in drives.stdout.readline()
                elif words[0] == "servo-sim":
                    drives = stack.enter_context(simulator(words))
                else:
                    assert words[0] == "servo-gateway", line
                    done = command(*words[1:], input="y\n" * 3)
                    assert done.exit_code == 0, (line, done.output)
                    typed.append(words[1])
    assert typed[:8] == ["scan", "profiles", "cell", "check", "check", "record", "record", "estimate"]
    (load,) = json.loads((tmp_path / "out" / "own" / "result.json").read_text(encoding="utf-8"))["loads"]
    (true,) = read_payloads(bench.parent / "payload.toml").values()
    assert f"weighs {true.mass_kg:g} kg" in PAGE.read_text(encoding="utf-8")
    assert abs(load["mass_kg"] - true.mass_kg) < 1.96 * load["mass_std_kg"]
