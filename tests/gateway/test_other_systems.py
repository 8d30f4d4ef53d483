"""Commands that need no bus are loaded on systems that lack what Linux alone has."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from gateway.cli import main

#: Modules of Python that Windows lacks; macOS has them.
LACKING = ("fcntl", "termios", "tty", "pty", "resource", "grp", "pwd")
#: What modules that Windows has lack there; macOS lacks some of it.
LACKING_NAMES = {
    "signal": ("SIGHUP", "SIGKILL", "SIGALRM", "pthread_sigmask", "setitimer"),
    "os": (
        *("O_NONBLOCK", "O_CLOEXEC", "O_NOFOLLOW", "geteuid", "getuid", "nice", "mkfifo", "fork", "statvfs"),
        *("sched_getaffinity", "sched_getscheduler", "sched_setscheduler", "sched_param", "SCHED_FIFO"),
    ),
    "select": ("poll", "epoll"),
    "socket": ("AF_CAN", "socketpair"),
}
#: What the commands without a bus are made of.
OFFLINE = (
    "gateway.api",
    "gateway.cli",
    "gateway.commands.identification",
    "gateway.commands.cell",
    "gateway.commands.compare",
    "gateway.commands.doctor",
    "gateway.commands.fleet",
    "gateway.commands.report_export",
    "gateway.commands.measure",
    "gateway.commands.profiles",
    "gateway.pipeline.inputs",
    "gateway.pipeline.finalize",
    "gateway.estimate",
    "gateway.diagnose",
    "gateway.acquire.planning",
    "gateway.acquire.planning",
    "gateway.data.recording.reader",
    "gateway.formats.registry",
    "gateway.newcell.interview",
    "gateway.newcell.nodes",
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
for module, names in {names!r}.items():
    for name in names:
        vars(importlib.import_module(module)).pop(name, None)
"""


def without(code: str) -> subprocess.CompletedProcess[str]:
    """Run code where these modules are not there."""
    text = BLOCK.format(lacking=LACKING, names=LACKING_NAMES) + code
    return subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_commands_without_a_bus_are_imported():
    done = without(f"for name in {OFFLINE!r}:\n    importlib.import_module(name)\n")
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_a_table_is_estimated_there_as_here(tmp_path):
    examples = Path(__file__).parents[2] / "examples"
    words = ["estimate", str(examples / "python" / "hidden_balancer.csv")]
    words += ["--cell", str(examples / "large" / "cell.toml"), "--json"]
    done = without(f"from gateway.cli import main\nmain({[*words, str(tmp_path / 'there.json')]!r})\n")
    assert done.returncode == 0, done.stderr
    assert CliRunner().invoke(main, [*words, str(tmp_path / "here.json")]).exit_code == 0
    there, here = (json.loads((tmp_path / name).read_text(encoding="utf-8")) for name in ("there.json", "here.json"))
    assert there["loads"] == here["loads"]
    assert here["loads"][0]["mass_kg"] == pytest.approx(70.0, rel=0.1)  # payload.toml of the simulator


@pytest.mark.slow
def test_a_file_is_written_and_a_lock_is_refused_in_words(tmp_path):
    code = (
        "import os\nfrom pathlib import Path\nfrom drives.files import replace_file\n"
        "from drives.files import lock_file\n"
        f"path = Path({str(tmp_path / 'a.txt')!r})\nreplace_file(path, 'text')\nreplace_file(path, 'more')\n"
        "assert path.read_text() == 'more'\n"
        "try:\n    lock_file(os.open(path, os.O_RDONLY))\n"
        "except OSError as error:\n    assert 'needs Linux' in str(error), error\n"
        "else:\n    raise AssertionError('locked')\n"
    )
    done = without(code)
    assert done.returncode == 0, done.stderr
