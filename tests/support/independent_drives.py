"""Start the drives of `independent_drive` as a process, and give them commands."""

from __future__ import annotations

import json
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
#: How much longer everything may take: an emulated processor that others use too is slow.
PATIENCE = 30.0 if os.environ.get("SERVO_GATEWAY_IN_VM") == "1" else 2.0
SIX = (1, 2, 3, 4, 5, 6)
#: Comes after the last line that the process prints.
ENDED = "ended"


class IndependentDrives:
    """Drives on the stack `durand` in a process of their own.

    Parameters
    ----------
    bus : str
        INTERFACE:CHANNEL[,key=value]...
    nodes : sequence of int
        Node ids of the axes in their order.
    variant : "zero-extended", "no-size" or "interpolated"
    """

    def __init__(self, bus: str, nodes: Sequence[int] = SIX, variant: str = "zero-extended") -> None:
        self.bus, self.variant = bus, variant
        module = "tests.support.independent_drive"
        words = ["-m", module, "--bus", bus, "--node", ",".join(map(str, nodes)), "--variant", variant]
        self._process = subprocess.Popen(
            [sys.executable, *words], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
        )
        self._said: queue.Queue[str] = queue.Queue()
        self._reader = threading.Thread(target=self._read, daemon=True)

    def __enter__(self) -> IndependentDrives:
        self._reader.start()
        try:
            self._wait_for("ready")
        except BaseException:
            self.kill()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()

    def kill(self) -> None:
        """End the process at once, as a power cut would."""
        self._process.kill()
        self._process.wait()
        self._reader.join()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()

    def ask(self, command: str) -> str:
        """Give a command and wait for the answer: its first word, and what follows it."""
        if self._process.stdin is None:
            raise RuntimeError("the process has no standard input")
        self._process.stdin.write(command + "\n")
        return self._wait_for(command.split()[0])

    def attach(self, mass_kg: float, com_m: Sequence[float]) -> None:
        """Attach a load at the last link [kg, m in its frame]."""
        self.ask(f"load {mass_kg} {' '.join(map(str, com_m))}")

    def stop_speeds(self) -> list[list[float]]:
        """Of each axis, the speeds of its joint at which quick stops began so far [rad/s]."""
        return json.loads(self.ask("stops"))

    def read(self, node: int, index: int, subindex: int) -> int:
        """What an object of a drive holds, past the bus."""
        return int(self.ask(f"read {node} {index} {subindex}"))

    def _wait_for(self, first: str) -> str:
        while not (line := self._said.get(timeout=20.0 * PATIENCE)).startswith(first):
            if line == ENDED:
                raise RuntimeError(f"the drives' process ended before it said {first!r}")
        return line.removeprefix(first).strip()

    def _read(self) -> None:
        for line in self._process.stdout or ():
            self._said.put(line.strip())
        self._said.put(ENDED)
