"""calibrate on simulated drives whose torque constants are not those of the cell file."""

from __future__ import annotations

import json

import pytest

from gateway.cell.calibration import calibration_path, parse_calibration
from tests.system.conftest import with_few_poses

TRUTH_KG = 6.0
#: True torque over reported torque.
SCALE = {2: 1.04, 3: 0.96}
EFFECT = "".join(
    f'[[effect]]\nname = "torque_constant_scale"\njoints = [{joint}]\nparameters = {{ scale = {scale} }}\n'
    for joint, scale in SCALE.items()
)


@pytest.mark.slow
def test_the_guided_calibration_and_the_load_that_is_measured_with_it(place, serve, guided, gateway, fast_arm):
    with_few_poses(place)
    # of three poses the diagnosis asks for eight further ones that narrow its interval
    place.cell.write_text(place.cell.read_text(encoding="utf-8").replace("count = 4", "count = 3"), encoding="utf-8")
    out = place.folder / "out"
    drives = fast_arm(serve(effect=EFFECT))
    code, hands, output = guided("calibrate", drives, "--known", f"load={TRUTH_KG}", "--json", out.parent / "c.json")
    assert code == 0, output.err
    assert hands.asked == ["load", "none"], "unloaded, mounted, unloaded"
    assert drives.stand_still()
    path = calibration_path(place.cell)
    held = parse_calibration(path.read_text(encoding="utf-8"), str(path)).of("main")
    for joint, truth in SCALE.items():
        run, axis = held[joint]
        assert abs(axis.torque_scale - truth) < 4 * axis.std_percent / 100
        assert axis.std_percent < 1.5
        assert (run.mass_kg, run.data) == (TRUTH_KG, ("calibrate.h5",))
        assert axis.serial_number, "drives report their serial numbers"
    answer = json.loads((out.parent / "c.json").read_text())
    assert {axis["joint"] for axis in answer["axes"] if axis["is_known"]} == set(held)

    code, hands, output = guided("commission", drives, "--load", "load")
    result = json.loads((out / "result.json").read_text())
    (load,) = result["loads"]
    assert abs(load["mass_kg"] - TRUTH_KG) < 4 * load["mass_std_kg"]
    assert load["mass_std_kg"] < 0.015 * TRUTH_KG
    assert [each for each in result["findings"] if each["where"] == "calibration"], output.err
    alone = gateway("estimate", out / "run.h5", "--json", "-")
    assert any(each["where"] == "calibration" for each in json.loads(alone.stdout)["findings"]), (
        "it is in the recording"
    )

    path.write_text(path.read_text().replace(f"serial_number = {held[2][1].serial_number}", "serial_number = 999999"))
    other = gateway("estimate", out / "run.h5", "--cell", place.cell, "--json", "-")
    warned = [each for each in json.loads(other.stdout)["findings"] if "999999" in each["what"]]
    assert [(each["severity"], each["where"]) for each in warned] == [("warn", "J2")]


@pytest.mark.parametrize(
    ("known", "message"),
    [("load=0.02,0,0,0", "no axis carries enough of the load"), ("load=11", "beyond the rated load of 10 kg")],
)
def test_a_load_that_calibrates_nothing_is_refused_before_anything_moves(place, serve, guided, known, message):
    drives = serve()
    code, hands, output = guided("calibrate", drives, "--known", known)
    assert (code, message in " ".join(output.err.split())) == (5, True), output.err
    assert hands.asked == []
    assert not (place.folder / "out" / "calibrate.h5").exists()
    assert not calibration_path(place.cell).exists()
