"""The wheel: built from the tracked files alone, what is in it, what an environment with nothing else takes."""

from __future__ import annotations

import os
import shutil
import statistics
import subprocess
import sys
import time
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("drives", "gateway", "sim")
#: Any fixed time: files in a zip carry one (2024-01-01).
SOURCE_DATE_EPOCH = "1704067200"


def tracked_files(*folders: str) -> list[str]:
    """Files under version control, by their path in the repository."""
    words = ["git", "-C", str(ROOT), "ls-files", "-z", "--cached", "--others", "--exclude-standard", *folders]
    return sorted(filter(None, subprocess.run(words, capture_output=True, check=True).stdout.decode().split("\0")))


def build_wheel(folder: Path) -> Path:
    """Copy the tracked files into `folder` and build the wheel there, with the setuptools that is installed."""
    source = folder / "source"
    for name in tracked_files():
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, source / name, follow_symlinks=False)
    code = f"from setuptools import build_meta\nprint(build_meta.build_wheel({str(folder)!r}))"
    environment = os.environ | {"SOURCE_DATE_EPOCH": SOURCE_DATE_EPOCH}
    words = [sys.executable, "-c", code]
    done = subprocess.run(words, cwd=source, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(done.stderr[-2000:])
    return folder / done.stdout.split()[-1]


def misplaced(wheel: Path) -> list[str]:
    """Files of a wheel that are no part of the three packages, or that no program needs."""
    found: list[str] = []
    for name in zipfile.ZipFile(wheel).namelist():
        parts = Path(name).parts
        is_ours = parts[0] in PACKAGES or parts[0].endswith(".dist-info")
        if not is_ours or {"tests", "test", "__pycache__"} & set(parts) or name.endswith((".pyc", ".orig", ".h5")):
            found.append(name)
    return found


def forgotten(wheel: Path) -> list[str]:
    """Tracked files of the three packages that the wheel lacks; what a link leads to counts under its own name."""
    held = set(zipfile.ZipFile(wheel).namelist())
    links = [name for name in tracked_files(*PACKAGES) if (ROOT / name).is_symlink()]
    behind = [f"{name}/{each.name}" for name in links for each in (ROOT / name).iterdir()]
    return sorted({*tracked_files(*PACKAGES), *behind} - {*links} - held)


def install(wheel: Path, environment: Path) -> Path:
    """A new environment with the wheel and, by their hashes, the packages that it needs; its folder of programs."""
    subprocess.run([sys.executable, "-m", "venv", "--clear", str(environment)], check=True)
    programs = environment / "bin"
    pip = [str(programs / "python"), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "--require-hashes", "-r", str(ROOT / "requirements.txt")], check=True)
    subprocess.run([*pip, "--no-deps", str(wheel)], check=True)
    return programs


def size_mb(folder: Path) -> float:
    """Size of all files beneath a folder, as `du -sm --apparent-size` counts it, without pip and setuptools."""
    own = ("pip", "setuptools", "_distutils_hack", "pkg_resources")
    sites = [each for each in folder.glob("lib/python*/site-packages/*") if not each.name.startswith(own)]
    files = [file for each in sites for file in (each.rglob("*") if each.is_dir() else [each])]
    return sum(file.stat().st_size for file in files if file.is_file()) / 1e6


def help_s(programs: Path, repeats: int = 9) -> float:
    """Median time of `servo-gateway --help` [s]."""
    took: list[float] = []
    for _ in range(repeats):
        begin_s = time.perf_counter()
        subprocess.run([str(programs / "servo-gateway"), "--help"], stdout=subprocess.DEVNULL, check=True)
        took.append(time.perf_counter() - begin_s)
    return statistics.median(took)
