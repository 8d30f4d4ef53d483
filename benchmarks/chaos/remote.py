"""Simulated drives in a process of their own, which keeps its rhythm whatever the master's process does."""

from __future__ import annotations

import multiprocessing
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from benchmarks.chaos.rig import Rig, Watched, with_real_pacing
from drives.realtime import RealTime
from gateway.cell.config import LoadedCell, load_cell
from sim.fault import Fault
from sim.serve import free_bus

PATIENCE_S = 60.0
_SPAWN = multiprocessing.get_context("spawn")


class Remote:
    """As `Rig`, in real time, the drives being elsewhere.

    Attributes
    ----------
    loaded : LoadedCell
    bus : INTERFACE:CHANNEL[,..]
    """

    def __init__(self, pipe: Connection, loaded: LoadedCell, bus: str) -> None:
        self.loaded, self.bus = loaded, bus
        self._pipe = pipe

    def _ask(self, name: str, *arguments: Any) -> Any:
        self._pipe.send((name, arguments))
        if not self._pipe.poll(PATIENCE_S):
            raise TimeoutError(f"the drives' process does not answer '{name}'")
        return self._pipe.recv()

    def renew(self) -> None:
        """No fault on the wire, every drive as after power-up, nothing seen."""
        self._ask("renew")

    def sync(self) -> int:
        """Number of the last SYNC on the wire."""
        return self._ask("sync")

    def arm(self, fault: Fault) -> None:
        """Let a fault begin now."""
        self._ask("arm", fault)

    def arm_in(self, fault: Fault, syncs: int) -> None:
        """Let a fault begin after so many more SYNCs."""
        self._ask("arm_in", fault, syncs)

    def all_well(self) -> None:
        """Let every drive say by an emergency message that it has no error."""
        self._ask("all_well")

    def watched(self) -> Watched:
        """What was seen since `renew`."""
        return self._ask("watched")


def _serve(folder: Path, period_s: float, bus: str, mode: int, pipe: Connection) -> None:
    with RealTime(), Rig(folder, with_real_pacing(period_s), bus, mode=mode) as rig:
        pipe.send("ready")
        while (question := pipe.recv()) is not None:
            name, arguments = question
            pipe.send(getattr(rig, name)(*arguments))


@contextmanager
def remote(period_s: float, mode: int = 8) -> Iterator[Remote]:
    """Drives of the small arm in real time, in a process of their own.

    Parameters
    ----------
    period_s : float
        SYNC period.
    mode : int
        Cyclic mode of the drives, 7 or 8.
    """
    with tempfile.TemporaryDirectory(prefix="rig-") as folder:
        bus = free_bus()
        ours, theirs = _SPAWN.Pipe()
        process = _SPAWN.Process(target=_serve, args=(Path(folder), period_s, bus, mode, theirs), daemon=True)
        process.start()
        try:
            if not ours.poll(PATIENCE_S) or ours.recv() != "ready":
                raise TimeoutError("the drives' process does not start")
            yield Remote(ours, load_cell(Path(folder) / "cell.toml"), bus)
            ours.send(None)
            process.join(10.0)
        finally:
            process.kill()
            process.join()
            ours.close()
            theirs.close()
