"""What a program does not load at its start: seconds on a small computer, at each command."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec

import pytest


def said(program: str) -> str:
    """What a fresh interpreter prints."""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


WITH_ENGINE = pytest.mark.skipif(find_spec("pybullet") is None, reason="pybullet is not installed")


@pytest.mark.skipif(find_spec("asammdf") is None, reason="asammdf is not installed")
@pytest.mark.parametrize("folder", ["drives.bus", "drives.profile_file", pytest.param("sim.server", marks=WITH_ENGINE)])
def test_python_can_is_loaded_without_the_library_of_mf4_files_which_stays_to_be_had(folder):
    found = said(
        f"import {folder}, sys\n"
        "print('can' in sys.modules, 'asammdf' in sys.modules, 'pandas' in sys.modules)\n"
        "import asammdf\nprint(asammdf.MDF is not None)"
    )
    assert found.split() == ["True", "False", "False", "True"]


@pytest.mark.slow
def test_planning_and_recording_do_without_the_distributions_of_scipy():
    assert said("import gateway.acquire.planning, sys\nprint('scipy.stats' in sys.modules)") == "False"
    assert said("import gateway.diagnose, sys\nprint('scipy.stats' in sys.modules)") == "False"
