"""A copy of the product with something added, to prove what an addition takes."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGES = ("gateway", "drives", "sim", "examples", "tests", "benchmarks")


class ProductCopy:
    """The product in a folder of its own.

    Parameters
    ----------
    root : Path
        Where the copy goes.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        for package in PACKAGES:
            shutil.copytree(ROOT / package, root / package, ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copy(ROOT / "pyproject.toml", root)

    def add(self, path: str, text: str) -> None:
        """Put one file beside the others."""
        (self.root / path).write_text(text)

    def change(self, path: str, old: str, new: str) -> None:
        """Change one line."""
        text = (self.root / path).read_text()
        assert text.count(old) == 1
        (self.root / path).write_text(text.replace(old, new))

    def run(self, *arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
        """Python with this copy of the product."""
        environment = os.environ | {"PYTHONPATH": str(self.root)}
        line = [sys.executable, *(str(argument) for argument in arguments)]
        return subprocess.run(
            line, cwd=cwd or self.root, env=environment, capture_output=True, text=True, check=False, timeout=300
        )

    def command(self, *arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
        """`servo-gateway` of this copy."""
        return self.run("-c", "from gateway.cli import main; main()", *arguments, cwd=cwd)
