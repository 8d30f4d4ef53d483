"""The command line with an adapter that can be pulled: from the moment a file exists, nothing is sent or received."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from benchmarks.chaos.rig import adapters
from gateway.cli import main

#: Environment of errno values that a pulled USB adapter gives.
NO_DEVICE, NO_INPUT = (19, "No such device"), (5, "Input/output error")


class Pluggable:
    """An adapter that is there until a file exists."""

    def __init__(self, adapter: Any, pulled: Path) -> None:
        self._adapter, self._pulled = adapter, pulled

    def send(self, frame: Any, timeout: float | None = None) -> None:
        if self._pulled.exists():
            raise OSError(*NO_DEVICE)
        self._adapter.send(frame, timeout)

    def recv(self, timeout: float | None = None) -> Any:
        if self._pulled.exists():
            raise OSError(*NO_INPUT)
        return self._adapter.recv(timeout)

    def shutdown(self) -> None:
        self._adapter.shutdown()


if __name__ == "__main__":
    file = Path(sys.argv.pop(1))
    with adapters(lambda adapter: Pluggable(adapter, file)):
        main()
