"""PyBullet physics engine, with its console output suppressed."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
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

#: Attempts at building the links of an arm, and how much further out their centres of gravity are in each.
NUDGES, NUDGE = 12, 1e-11


@contextmanager
def unsaid_if_raised() -> Generator[None]:
    """Buffer the engine's console output during the block, and discard it if the block raises."""
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


def load_arm(text: str, client: int) -> int:
    """Load an arm from a URDF with fixed base, without damping and with the inertias of the file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(text, encoding="utf-8")
        flags = bullet.URDF_USE_INERTIA_FROM_FILE
        body = bullet.loadURDF(str(path), useFixedBase=True, flags=flags, physicsClientId=client)
    for joint in range(-1, bullet.getNumJoints(body, physicsClientId=client)):
        bullet.changeDynamics(body, joint, linearDamping=0, angularDamping=0, jointDamping=0, physicsClientId=client)
    return body


def usable(body: int, q_rad: list[float], client: int) -> bool:
    """Return whether the engine can compute inverse dynamics of an arm; its console output is discarded."""
    try:
        with unsaid_if_raised():
            bullet.calculateMassMatrix(body, q_rad, physicsClientId=client)
    except (bullet.error, SystemError):  # the one is raised from the other
        return False
    return True
