"""Arms of four and of seven axes, from the cell file to the report: checked, proven, recorded, estimated."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from gateway.data.recording.reader import read
from gateway.data.table import read_csv, write_csv
from tests.cells import CELLS
from tests.support.rigs.pacing import measured_shortly
from tests.system.conftest import Place


@pytest.fixture(params=CELLS, ids=lambda cell: cell.name)
def arm(request):
    return request.param


@pytest.fixture
def place(arm, tmp_path) -> Place:
    for name in ("cell.toml", "robot.urdf", "payload.toml"):
        shutil.copy(arm.folder / name, tmp_path / name)
    cell = tmp_path / "cell.toml"
    cell.write_text(measured_shortly(cell.read_text(encoding="utf-8")), encoding="utf-8")
    return Place(tmp_path)


def load_of(place):
    text = place.payload.read_text(encoding="utf-8")
    (mass,) = (float(line.split("=")[1]) for line in text.splitlines() if line.startswith("mass_kg"))
    (com,) = (json.loads(line.split("=")[1]) for line in text.splitlines() if line.startswith("com_m"))
    return mass, np.array(com)


@pytest.mark.slow
@pytest.mark.parametrize("arm", CELLS[1:], ids=["seven"], indirect=True)
def test_from_the_cell_to_the_report(place, serve, gateway, arm):
    def ran(*arguments):
        result = gateway(*arguments)
        assert result.exit_code == 0, result.output
        return result

    text = place.cell.read_text(encoding="utf-8")
    place.cell.write_text(text.replace("count = 6", "count = 5").replace("validation = 2", "validation = 0"))
    drives = serve()
    bus = ("--bus", drives.bus)
    bare, loaded, plan = (place.folder / name for name in ("bare.h5", "loaded.h5", "plan.json"))
    proven = place.folder / "proven.json"
    ran("check", place.cell, *bus, "--prove-stop", "--move", "--yes", "--json", proven)
    assert f"J{arm.axes}" in proven.read_text(encoding="utf-8")
    ran("plan", place.cell, "--json", plan)
    assert {len(pose["q_rad"]) for pose in json.loads(plan.read_text())["poses"]} == {arm.axes}
    ran("record", place.cell, *bus, "--yes", "--load", "none", "-o", bare)
    drives.mount("load")
    ran("record", place.cell, *bus, "--yes", "--load", "load", "-o", loaded)

    mass, com = load_of(place)
    for method in ("joint", "difference", "posture"):
        found = place.folder / f"{method}.json"
        ran("estimate", bare, loaded, "--cell", place.cell, "--method", method, "--json", found)
        body = json.loads(found.read_text())
        (load,) = body["loads"]
        assert load["frame"] == f"link_{arm.axes}"
        assert abs(load["mass_kg"] - mass) < max(4 * load["mass_std_kg"], 0.02), (method, load)
        assert (np.abs(load["com_m"] - com) < np.maximum(4 * np.array(load["com_std_m"]), 0.002)).all(), (method, load)
        assert len(body["after"]["rms_nm"]) == len(body["friction_band_nm"]) == arm.axes
        page = found.with_suffix(".html")
        ran("report", found, "-o", page)
        assert f"J{arm.axes}" in page.read_text(encoding="utf-8")
        assert f"J{arm.axes + 1}" not in page.read_text(encoding="utf-8")
    for form in ("urdf", "json"):
        ran("export", place.folder / "joint.json", "--format", form)

    table = read(loaded).table()
    write_csv(table, place.folder / "loaded.csv")
    again = read_csv(place.folder / "loaded.csv", None)
    assert again.axes == arm.axes
    np.testing.assert_array_equal(again.tau_nm, table.tau_nm)


@pytest.mark.slow
@pytest.mark.parametrize("arm", CELLS[:1], ids=["four"], indirect=True)
def test_a_reversed_torque_is_found_by_small_moves(place, serve, gateway, monkeypatch):
    monkeypatch.setenv("COLUMNS", "400")
    drives = serve(effect='[[effect]]\nname = "sign_reversed"\njoints = [2]\n')
    said = gateway("check", place.cell, "--bus", drives.bus, "--prove-stop", "--move", "--yes")
    assert said.exit_code == 7, said.output
    words = " ".join(said.output.split())
    assert "J2 node 2" in words
    assert "torque sign is reversed" in words or "opposite signs" in words


def test_a_path_is_not_followed(place, gateway, arm):
    (place.folder / "path.csv").write_text("q1_rad\n0\n", encoding="utf-8")
    said = gateway("follow", place.cell, place.folder / "r.json", "--path", place.folder / "path.csv", "--yes")
    assert said.exit_code == 3
    assert f"arm 'main' has {arm.axes} axes; follow supports 6 axes only" in said.output
