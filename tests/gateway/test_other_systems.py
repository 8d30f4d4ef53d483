"""Commands that need no bus are loaded on systems that lack what Linux alone has."""

from __future__ import annotations

import subprocess
import sys

import pytest

#: Modules of Python that Windows lacks; macOS has them.
LACKING = ("fcntl", "termios", "tty", "pty", "resource", "grp", "pwd")
#: What the commands without a bus are made of.
OFFLINE = (
    "gateway.cli",
    "gateway.commands.analyse",
    "gateway.commands.cell",
    "gateway.commands.compare",
    "gateway.commands.doctor",
    "gateway.commands.fleet",
    "gateway.commands.handover",
    "gateway.commands.measure",
    "gateway.commands.profiles",
    "gateway.analyse.given",
    "gateway.analyse.complete",
    "gateway.estimate",
    "gateway.diagnose",
    "gateway.acquire.planning",
    "gateway.acquire.asking",
    "gateway.data.recording.reader",
    "gateway.formats.registry",
    "gateway.newcell.interview",
    "gateway.newcell.reading",
    "gateway.report.render",
    "gateway.report.stop",
)
BLOCK = """
import importlib, sys
class Lacking:
    def find_spec(self, name, path=None, target=None):
        if name in {lacking!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
for name in {lacking!r}:
    sys.modules.pop(name, None)
sys.meta_path.insert(0, Lacking())
"""


def without(code: str) -> subprocess.CompletedProcess[str]:
    """Run code where these modules are not there."""
    text = BLOCK.format(lacking=LACKING) + code
    return subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_commands_without_a_bus_are_imported():
    done = without(f"for name in {OFFLINE!r}:\n    importlib.import_module(name)\n")
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_a_file_is_written_and_a_lock_is_refused_in_words(tmp_path):
    code = (
        "import os\nfrom pathlib import Path\nfrom drives.files import replace_file\n"
        "from drives.file_lock import lock_file\n"
        f"path = Path({str(tmp_path / 'a.txt')!r})\nreplace_file(path, 'text')\nreplace_file(path, 'more')\n"
        "assert path.read_text() == 'more'\n"
        "try:\n    lock_file(os.open(path, os.O_RDONLY))\n"
        "except OSError as error:\n    assert 'needs Linux' in str(error), error\n"
        "else:\n    raise AssertionError('locked')\n"
    )
    done = without(code)
    assert done.returncode == 0, done.stderr
