"""The public Python interface: names and arguments, answers beside those of the commands, a drive that is read."""

from __future__ import annotations

import inspect
import json
import os
import re
import subprocess
import sys
import threading
from pathlib import Path

import canopen
import pytest
from canopen import ObjectDictionary
from canopen.objectdictionary import ODVariable, datatypes
from click.testing import CliRunner

from drives.errors import SdoError
from gateway import api
from gateway.cli import main
from gateway.errors import InputError

EXAMPLES = Path(__file__).parents[2] / "examples"
SCRIPT = EXAMPLES / "python" / "load_and_effect.py"
TABLE = EXAMPLES / "python" / "hidden_balancer.csv"
CELL = EXAMPLES / "large" / "cell.toml"
MODEL = api.ModelRequest(cell=CELL)
#: What others have written programs against: a name or an argument that goes is deprecated for one version first.
PUBLIC = {
    "diagnose": ["data", "model", "holdout", "only", "without", "expected", "operator", "say", "working"],
    "estimate": ["data", "model", "method", "coefficient", "expected", "operator", "say", "working"],
    "load_cell": ["path"],
    "read": ["data", "model"],
    "read_result": ["path"],
    "render": ["result"],
    "to_json": ["result"],
    "Drive": ["bus", "node_id"],
    "KnownLoad": ["mass_kg", "com_m", "frame", "mass_std_kg", "com_std_m"],
    "ModelRequest": [
        *("robot", "cell", "inertials", "known", "parts", "bare", "arm", "gain_std", "tip", "is_warm", "calibrated"),
    ],
}


def test_public_names_and_arguments_stay():
    assert set(PUBLIC) <= set(api.__all__)
    for name, arguments in PUBLIC.items():
        assert list(inspect.signature(getattr(api, name)).parameters) == arguments, name
    for name in api.__all__:
        assert inspect.getdoc(getattr(api, name)), name


def test_the_package_alone_is_imported_without_its_libraries():
    code = (
        "import sys, gateway\nassert gateway.__version__\n"
        "heavy = {'numpy', 'scipy', 'can', 'canopen', 'pydantic', 'h5py', 'jinja2', 'click'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_rows_are_those_of_the_table():
    rows = api.read(TABLE, MODEL)
    header, first, *others = TABLE.read_text(encoding="utf-8").splitlines()
    column = dict(zip(header.split(","), first.split(","), strict=True))
    assert rows.tau_nm.shape == (len(others) + 1, 6)
    assert rows.q_rad[0, 1] == float(column["q2_rad"])
    assert rows.tau_nm[0, 1] == float(column["tau2_nm"])


def test_an_effect_that_is_none_is_refused_with_the_names():
    with pytest.raises(InputError, match="'spring' is not an effect; choose from .*balancer_spring"):
        api.diagnose(TABLE, MODEL, only=["spring"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "answer"),
    [
        ("estimate", lambda: api.estimate(TABLE, MODEL)),
        ("diagnose", lambda: api.diagnose([TABLE], MODEL, only=["balancer_spring"])),
    ],
)
def test_answers_are_those_of_the_command(command, answer, tmp_path):
    out = tmp_path / "result.json"
    options = ["--only", "balancer_spring"] if command == "diagnose" else []
    done = CliRunner().invoke(main, [command, str(TABLE), "--cell", str(CELL), "--json", str(out), *options])
    assert done.exit_code == 0, done.output
    said, found = json.loads(out.read_text(encoding="utf-8")), json.loads(api.to_json(answer()))
    for result in (said, found):
        result.pop("sha256")
        result["data"].pop("created")
    assert found == said


@pytest.mark.slow
def test_the_example_measures_a_load_on_simulated_drives(tmp_path):
    script, place = EXAMPLES / "python" / "measure_a_load.py", os.environ | {"XDG_STATE_HOME": str(tmp_path / "state")}
    done = subprocess.run([sys.executable, script, tmp_path], capture_output=True, text=True, check=False, env=place)
    assert done.returncode == 0, done.stderr
    mass_kg, std_kg = map(float, re.search(r"load gripper: (\S+) kg, .* (\S+) kg", done.stdout).groups())
    assert abs(mass_kg - 6.0) < 3 * std_kg < 1.0  # the simulator's payload.toml of examples/small
    assert set(api.read(tmp_path / "run.h5").load) == {"gripper", "none"}


@pytest.mark.slow
def test_the_example_finds_the_load_and_the_balancer(tmp_path):
    page = tmp_path / "page.html"
    done = subprocess.run([sys.executable, str(SCRIPT), str(page)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "effect: balancer_spring of joints [2]" in done.stdout
    mass_kg, std_kg = map(float, re.search(r"diagnosis: gripper (\S+) kg, .* (\S+) kg", done.stdout).groups())
    # the simulator's payload.toml of examples/large
    assert abs(mass_kg - 70.0) < 3 * std_kg < 10.0
    text = page.read_text(encoding="utf-8")
    assert "<svg" in text
    assert "balancer" in text


@pytest.fixture
def peer():
    """A node of the canopen library on a virtual bus: not written by this project."""
    dictionary = ObjectDictionary()
    for index, name, kind, value in (
        (0x1000, "device type", datatypes.UNSIGNED32, 0x00020192),
        (0x6041, "statusword", datatypes.UNSIGNED16, 0x0237),
        (0x6064, "position", datatypes.INTEGER32, -12345),
        (0x1008, "name", datatypes.VISIBLE_STRING, "axis three"),
    ):
        entry = ODVariable(name, index)
        entry.data_type, entry.access_type, entry.default = kind, "ro", value
        dictionary.add_object(entry)
    network = canopen.Network()
    network.connect(interface="virtual", channel="api")
    network.add_node(canopen.LocalNode(3, dictionary))
    yield
    network.disconnect()


def test_a_drive_is_read(peer):
    threads = threading.active_count()
    with api.Drive("virtual:api", 3) as drive:
        assert drive.read("statusword") == 0x0237
        assert drive.read("position") == -12345
        assert drive.read("device_name") == "axis three"
        assert drive.identity().device_type == 0x00020192
        assert drive.identity().serial_number is None
        with pytest.raises(SdoError):
            drive.read("position_demand")
        with pytest.raises(KeyError):
            drive.read("no such object")
    assert threading.active_count() == threads
