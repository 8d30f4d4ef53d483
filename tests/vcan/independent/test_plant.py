"""The drives of `tests/support/independent_drive` rest on nothing of this project; their arm is that of the cell."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pinocchio
import pytest

from tests.support import independent_drive
from tests.support.independent_drive.arm import moments_of_weight

HERE = Path(__file__).parent
SOURCES = sorted(Path(independent_drive.__file__).parent.glob("*.py"))


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.name)
def test_nothing_of_the_project_is_imported(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
        for name in names:
            assert name.split(".")[0] not in ("drives", "gateway", "sim", "benchmarks")
            assert not name.startswith("tests.") or name.startswith("tests.support.independent_drive")


def test_moments_of_weight_are_those_of_the_urdf() -> None:
    model = pinocchio.buildModelFromUrdf(str(HERE / "robot.urdf"))
    model.gravity.linear = np.array([0.0, 0.0, -9.80665])
    mass, com = 3.2, (0.05, 0.02, -0.03)
    loaded = model.copy()
    loaded.appendBodyToJoint(6, pinocchio.Inertia(mass, np.array(com), np.zeros((3, 3))), pinocchio.SE3.Identity())
    for angles in np.random.default_rng(1).uniform(-2.5, 2.5, (20, 6)):
        for wanted, load in ((model, None), (loaded, (mass, com))):
            expected = pinocchio.computeGeneralizedGravity(wanted, wanted.createData(), angles)
            assert moments_of_weight(angles.tolist(), load) == pytest.approx(expected, abs=1e-9)
