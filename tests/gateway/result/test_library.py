"""Library of the loads of a robot: what is saved, read as a result, exported together, and refused."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from gateway.cli import main
from gateway.errors import InputError
from gateway.pipeline.saved_loads import save_loads
from gateway.result.export import export, loads_of_library
from gateway.result.result import from_json, read_result, to_json
from tests.data.wrong_inputs import RESULT


def saved(folder, label, file):
    """Save a load of one result file in the library of `cell.toml`."""
    result = from_json(json.dumps({key: value for key, value in RESULT.items() if key != "sha256"}))
    load = replace(result.loads[0], label=label, mass_kg=5.0, mass_std_kg=0.02, com_flange_m=(0.0, 0.0, 0.1))
    written = replace(result, loads=(load, replace(load, label=f"{label} 2")))
    (folder / file).write_text(to_json(written), encoding="utf-8")
    return save_loads(folder / "cell.toml", written, folder / file)


def test_each_load_of_a_library_is_its_result_and_all_make_one_controller_file(tmp_path):
    saved(tmp_path, "a", "a.json")
    path = saved(tmp_path, "b", "b.json")
    assert [load.label for load in read_result(Path(f"{path}#b 2")).loads] == ["b 2"]
    for name in ("a", "a_2", "b", "b_2"):
        assert f"use_{name}()" in export(loads_of_library(path), "ur")
    done = CliRunner().invoke(main, ["export", str(path), "--format", "kuka"])
    assert (done.exit_code, "LOAD_DATA[4]" in done.stdout) == (0, True), done.output
    done = CliRunner().invoke(main, ["export", str(path), "--format", "dcc"])
    assert (done.exit_code, "name one load" in done.stderr) == (3, True)


def test_what_is_there_moved_edited_or_not_named_is_refused(tmp_path):
    path = saved(tmp_path, "a", "a.json")
    for named, says in ((path, "name one load"), (f"{path}#c", "holds a, a 2")):
        with pytest.raises(InputError, match=says):
            read_result(Path(named))
    assert saved(tmp_path, "a", "a.json") == path
    (tmp_path / "a.json").write_text("{}")
    with pytest.raises(InputError, match="sha256"):
        read_result(Path(f"{path}#a"))
    (tmp_path / "a.json").unlink()
    with pytest.raises(InputError, match="not there"):
        read_result(Path(f"{path}#a"))
    path.write_text(path.read_text().replace("5.0", "6.0"))
    with pytest.raises(InputError, match="edited"):
        loads_of_library(path)


def test_save_needs_a_cell_file_and_a_result_file():
    assert CliRunner().invoke(main, ["estimate", "t.csv", "--save", "--json", "-"]).exit_code == 2
