"""The whole job on simulated drives: check, bare, load, diagnosis, validation poses, report; then what follows."""

from __future__ import annotations

import hashlib
import json

import pytest

from tests.system.conftest import with_few_poses

TRUTH_KG, TRUTH_COM_M = 6.0, (0.02, 0.01, 0.10)


@pytest.mark.slow
@pytest.mark.usefixtures("fast_arm")
def test_the_whole_job_and_what_follows_from_it(place, serve, commission, gateway):
    """The load is mounted where the arm is."""
    lines = place.cell.read_text().splitlines(keepends=True)
    text = "".join(line for line in lines if not line.startswith("loading_rad"))
    # six poses show their own noise; of four the fresh ones may deviate by chance
    place.cell.write_text(text.replace("count = 4", "count = 6", 1))
    drives = serve()
    more = ("--expect", "load=6.0,0.6", "--operator", "A. Person", "--junit", place.folder / "accept.xml")
    code, result, hands, output = commission(drives, *more)
    assert code == 0, output.err
    assert [(row["what"], row["outcome"]) for row in result["acceptance"]] == [("mass", "pass"), ("rated mass", "pass")]
    assert 'failures="0"' in (place.folder / "accept.xml").read_text()
    assert hands.asked == ["load"]
    assert drives.stand_still()
    (load,) = result["loads"]
    assert result["verdict"] == "none_needed"
    assert result["holdout_kind"] == "fresh"
    assert abs(load["mass_kg"] - TRUTH_KG) < 4 * load["mass_std_kg"]
    for value, std, truth in zip(load["com_m"], load["com_std_m"], TRUTH_COM_M, strict=True):
        assert abs(value - truth) < 4 * std
    out = place.folder / "out"
    assert [drive["node_id"] for drive in result["data"]["drives"]] == [1, 2, 3, 4, 5, 6]
    page = (out / "report.html").read_text()
    source = hashlib.sha256((out / "run.h5").read_bytes()).hexdigest()
    for text in (source, "A. Person", "serial number", result["sha256"]):
        assert text in page
    for text in ("Is the model good?", "pose 7, validation", "datasheet p. 7", "SYNC cycles", "assumed"):
        assert text in page

    again = gateway("estimate", out / "run.h5", "--json", "-")
    assert again.exit_code == 0, again.output
    estimated = json.loads(again.stdout)["loads"][0]
    assert estimated["mass_kg"] == pytest.approx(load["mass_kg"], abs=3 * load["mass_std_kg"])
    exported = gateway("export", out / "result.json", "--format", "kuka")
    assert f"M {load['mass_kg']:.3f}," in exported.stdout
    assert gateway("report", out / "result.json", "-o", out / "again.html").exit_code == 0
    back = gateway("restore", place.cell, "--bus", drives.bus)
    assert back.exit_code == 0, back.output
    assert "objects restored" in back.stdout
    assert "nothing to restore" in gateway("restore", place.cell, "--bus", drives.bus).stdout


@pytest.mark.slow
def test_a_load_that_was_forgotten_is_asked_for_and_never_green(place, serve, commission, fast_arm):
    with_few_poses(place)
    code, result, _, output = commission(fast_arm(serve()), "--expect", "load=6.0,0.2", forgets=True)
    assert code == 7
    assert "kg: no load detected. Is it mounted?" in output.err
    (load,) = result["loads"]
    assert abs(load["mass_kg"]) < 1.96 * load["mass_std_kg"]
    assert [row["outcome"] for row in result["acceptance"] if row["what"] == "mass"] == ["fail"]
    page = (place.folder / "out" / "report.html").read_text()
    assert 'class="verdict good"' not in page
    assert "Is it mounted?" in page


def test_the_check_stops_the_job_before_anything_moves(place, serve, commission):
    drives = serve(fault='[[fault]]\nkind = "fault_at_start"\nnode = 3\n')
    code, result, hands, output = commission(drives)
    assert code == 7
    assert "not moved" in output.err
    assert result is None
    assert hands.asked == []
    assert not (place.folder / "out" / "run.h5").exists()


@pytest.mark.parametrize(
    ("command", "more", "names"),
    [
        ("commission", (), ("run.h5", "warm-up.h5", "result.json", "report.html")),
        ("commission", ("--repeat", "2"), ("01/run.h5", "repeatability.json")),
        ("calibrate", ("--known", "load=6,0.02,0.01,0.1"), ("calibrate.h5",)),
    ],
)
def test_earlier_files_keep_their_names_where_a_person_does_not_agree(place, serve, gateway, command, more, names):
    out = place.folder / "out"
    for name in names:
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_text("earlier")
    done = gateway(command, place.cell, "--bus", serve().bus, "-o", out, *more, input="n\n")
    assert done.exit_code == 130, done.output
    assert {str(path.relative_to(out)) for path in out.rglob("*.*")} == set(names)
    assert "Measured data" not in done.stderr


@pytest.mark.slow
def test_earlier_files_are_renamed_once_a_person_has_agreed_and_a_load_not_mounted_ends_it(
    place, serve, commission, fast_arm
):
    with_few_poses(place)
    out = place.folder / "out"
    out.mkdir()
    (out / "run.h5").write_text("earlier")
    drives = fast_arm(serve())
    code, result, _, output = commission(drives, mounts=False)
    assert (code, result) == (130, None)
    assert drives.stand_still()
    assert "kept" in output.err
    assert (out / "run.1.h5").read_text() == "earlier"
    assert "Measured data" in output.err


@pytest.mark.slow
def test_no_person_is_called_to_an_arm_whose_brake_does_not_hold(place, serve, commission, fast_arm):
    with_few_poses(place)
    drives = fast_arm(serve(fault='[[fault]]\nkind = "brake_falls"\nnode = 2\naccel_rad_s2 = 2.0\n'))
    code, result, hands, output = commission(drives)
    assert (code, result, hands.asked) == (4, None, [])
    assert "joint 2 sank by 0." in output.err
    assert "keep away from this arm" in output.err


@pytest.mark.slow
def test_a_move_after_which_a_brake_does_not_hold_fails(serve, fast_arm, gateway, place):
    drives = fast_arm(serve(fault='[[fault]]\nkind = "brake_falls"\nnode = 2\naccel_rad_s2 = 2.0\n'))
    done = gateway("move", place.cell, "--bus", drives.bus, "--to", "0,0.3,0.2,0,0.4,0", "--yes")
    assert done.exit_code == 4
    assert "joint 2 sank by 0." in done.stderr
    assert "is at" not in done.stdout


@pytest.mark.slow
def test_a_job_that_broke_is_gone_on_with(place, serve, commission, fast_arm):
    with_few_poses(place)
    broken = fast_arm(serve(fault='[[fault]]\nkind = "drive_fault"\nnode = 2\nat_sync = 1000\n'))
    code, result, _, output = commission(broken)
    assert code == 4
    assert "commission --resume" in output.err
    assert result is None
    assert broken.stand_still()
    code, result, _, output = commission(fast_arm(serve()), "--resume")
    assert code == 0, output.err
    assert result["loads"][0]["mass_kg"] == pytest.approx(TRUTH_KG, rel=0.02)
