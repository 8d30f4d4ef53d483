"""The wheel in an environment of its own: size, time to `--help`, software bill of materials, licences.

python -m benchmarks.package [--out out/package]

Leaves the wheel, `sbom.cdx.json` (CycloneDX) and `licences.md` in the folder.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.figure import conclude, figure
from benchmarks.program import options
from tests.support.package import build_wheel, forgotten, help_s, install, misplaced, size_mb


def main() -> int:
    """Exit 1 when a goal is missed."""
    out: Path = options(__doc__, "out/package").parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as one, tempfile.TemporaryDirectory() as other:
        first, second = build_wheel(Path(one)), build_wheel(Path(other))
        is_same = first.read_bytes() == second.read_bytes()
        wheel = out / first.name
        wheel.write_bytes(first.read_bytes())
    environment = (out / "environment").resolve()
    programs = install(wheel, environment)
    unlicensed = _bill_of_materials(programs / "python", out)
    figures = {
        "builds that differ": figure(0 if is_same else 1, "== 0"),
        "files that are forgotten or misplaced": figure(len(forgotten(wheel)) + len(misplaced(wheel)), "== 0"),
        "size of the wheel": figure(wheel.stat().st_size / 1e6, "<= 2", "MB"),
        "size of site-packages": figure(size_mb(environment), "<= 330", "MB"),
        "time to --help": figure(help_s(programs), "<= 0.2", "s"),
        "packages without a licence": figure(unlicensed, "== 0"),
    }
    return conclude(figures, out)


def _bill_of_materials(python: Path, out: Path) -> int:
    """Write the installed packages as CycloneDX and as a table of licences; how many state no licence."""
    sbom = out / "sbom.cdx.json"
    words = ["cyclonedx_py", "environment", "--output-reproducible", "--output-format", "JSON", "-o", str(sbom)]
    subprocess.run([sys.executable, "-m", *words, str(python)], check=True)
    words = ["piplicenses", "--from=mixed", "--format=markdown", f"--output-file={out / 'licences.md'}"]
    subprocess.run([sys.executable, "-m", *words, f"--python={python}"], check=True, stdout=subprocess.DEVNULL)
    return (out / "licences.md").read_text(encoding="utf-8").count("UNKNOWN")


if __name__ == "__main__":
    raise SystemExit(main())
