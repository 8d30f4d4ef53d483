"""The wheel: the same twice, nothing forgotten, and enough by itself; pins that agree; the simulator's programs."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from tests.support.package import PACKAGES, ROOT, build_wheel, forgotten, misplaced


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two builds from two copies of the sources."""
    return build_wheel(tmp_path_factory.mktemp("one")), build_wheel(tmp_path_factory.mktemp("other"))


@pytest.mark.slow
def test_two_builds_are_identical(wheels: tuple[Path, Path]) -> None:
    assert wheels[0].read_bytes() == wheels[1].read_bytes()


@pytest.mark.slow
def test_every_file_of_the_packages_and_no_other_is_in_the_wheel(wheels: tuple[Path, Path]) -> None:
    assert forgotten(wheels[0]) == []
    assert misplaced(wheels[0]) == []
    names = zipfile.ZipFile(wheels[0]).namelist()
    assert {f"{package}/py.typed" for package in PACKAGES} <= set(names)
    assert wheels[0].stat().st_size < 2e6


@pytest.mark.slow
def test_the_unpacked_wheel_is_enough(wheels: tuple[Path, Path], tmp_path: Path) -> None:
    zipfile.ZipFile(wheels[0]).extractall(tmp_path / "site")
    code = (
        "import sys\nfrom pathlib import Path\nimport gateway, sim.demo\n"
        f"assert Path(gateway.__file__).is_relative_to({str(tmp_path)!r})\n"
        f"assert Path(sim.demo.EXAMPLE).is_relative_to({str(tmp_path)!r})\n"
        "from gateway.api import load_cell\nprint(load_cell(sim.demo.EXAMPLE / 'cell.toml').cell.name)\n"
        "from gateway.cli import main\nmain(['profiles', 'list'])\n"
    )
    environment = os.environ | {"PYTHONPATH": str(tmp_path / "site")}
    words = [sys.executable, "-P", "-c", code]
    done = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("large")
    assert "generic-cia402" in done.stdout


def test_the_demo_is_a_command_of_the_simulator() -> None:
    words = [sys.executable, "-m", "sim", "demo", "--seed", "1", "--undeclared", str(ROOT / "pyproject.toml")]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "servo-sim demo" in done.stderr
    assert "exclude each other" in done.stderr


def test_a_package_of_the_simulator_that_is_missing_is_named() -> None:
    code = (
        "import sys\nsys.modules['pybullet'] = None\nsys.argv = ['servo-sim', 'demo']\nimport sim.__main__ as program\n"
    )
    done = subprocess.run([sys.executable, "-c", code + "program.main()"], capture_output=True, text=True, check=False)
    assert done.returncode == 3
    assert done.stderr == "servo-sim: pybullet is not installed: pip install 'servo-gateway[sim]'\n"


def _pins(text: str) -> dict[str, str]:
    return {
        re.sub(r"[-_.]+", "-", name).lower(): version
        for name, version in re.findall(r"(?m)^([\w.-]+)==([^\s\\]+)", text)
    }


def test_hashed_pins_are_the_pins_and_name_no_address() -> None:
    text = (ROOT / "requirements.txt").read_text(encoding="utf-8")
    pins, hashed = _pins((ROOT / "constraints.txt").read_text(encoding="utf-8")), _pins(text)
    assert hashed.items() <= pins.items()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    needed = {re.match(r"[\w-]+", each)[0].lower() for each in project["dependencies"]}  # type: ignore[index]
    assert needed <= set(hashed)
    for block in re.split(r"(?m)^(?=\w)", text)[1:]:
        assert re.search(r"--hash=sha256:[0-9a-f]{64}", block), block
    assert "://" not in text
