"""PyBullet without what it writes to the program's own output."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any


def _quietly() -> Any:
    """Import PyBullet without the line it writes to standard error, which belongs to the program's own messages."""
    sys.stderr.flush()
    kept = os.dup(2)
    try:
        with open(os.devnull, "wb") as sink:
            os.dup2(sink.fileno(), 2)
        import pybullet
    finally:
        os.dup2(kept, 2)
        os.close(kept)
    return pybullet


bullet = _quietly()


@contextmanager
def unsaid_if_raised() -> Generator[None]:
    """Keep back what the engine prints in the block, and drop it where the block raises."""
    kept = os.dup(1)
    with tempfile.TemporaryFile() as said:
        os.dup2(said.fileno(), 1)
        try:
            yield
        finally:
            os.dup2(kept, 1)
            os.close(kept)
        said.seek(0)
        os.write(1, said.read())
