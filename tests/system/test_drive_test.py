"""`check --timing` against simulated drives: figures, page and files; refused inputs."""

from __future__ import annotations

import json
import shutil
from collections import deque

import numpy as np
import pytest

from benchmarks.chaos.programs import TRIES
from benchmarks.chaos.sleeper import watched
from gateway.data.blackbox.box import read_box
from gateway.preflight import machine
from sim.faults import act, fault_of

#: A sleeper that is woken with a larger delay shows that this computer did not keep its time [s].
STALL_S = 0.004


@pytest.fixture
def tested(gateway, place, serve):
    """Run the test of some drives in lockstep; what the command says, and its reports."""

    def run(*more, code=0, prepare=lambda drives: None, **options):
        drives = serve(**options)
        prepare(drives)
        out = place.folder / "out"
        done = gateway("check", place.cell, "--timing", "--bus", drives.bus, "--yes", "-o", out, *more)
        assert code is None or done.exit_code == code, done.output
        return done, {path.stem: json.loads(path.read_text()) for path in sorted(out.glob("J*.json"))}, out, drives

    return run


@pytest.mark.slow
def test_a_good_drive_has_no_finding_and_a_page(tested):
    _, reports, out, drives = tested("--axis", "j2", "--axis", "J3")
    assert list(reports) == ["J2", "J3"]
    report = reports["J2"]
    assert (report["format"], report["version"], report["node"]) == ("servo-gateway drive-test", 1, 2)
    assert report["findings"] == []
    assert report["identity"]["serial"] == 0x510002
    figures = {each["name"]: each for each in report["figures"]}
    for name, low, high in (
        ("heartbeat_loss_to_standstill_s", 0.5, 0.56),
        ("quick_stop_time_s", 0.005, 0.06),
        ("fault_reaction_time_s", 0.01, 0.06),
        ("quick_stop_angle_rad", 0.0003, 0.001),
    ):
        assert low <= figures[name]["value"] <= high, figures[name]
        assert figures[name]["interval"][0] <= figures[name]["value"] <= figures[name]["interval"][1]
    page = (out / "timing.html").read_text()
    assert "2 drives tested, nothing found" in page
    assert drives.stand_still()


def flat_ramp(drive):
    steep = drive.motion.joint_ramp
    drive.motion.joint_ramp = lambda word: steep(word) / 60.0


def torque_of_the_sync_before_last(drive):
    kept, answer = deque(maxlen=3), drive.sync

    def delayed():
        kept.append(drive.reading_nm)
        drive.reading_nm = kept[0]
        answer()

    drive.sync = delayed


@pytest.mark.slow
@pytest.mark.parametrize(
    ("defect", "name", "low", "high", "text"),
    [
        (flat_ramp, "quick_stop_time_s", 0.2, 0.5, "its ramp 0x6085 states"),
        (torque_of_the_sync_before_last, "torque_age_s", 0.015, 0.027, "Age of the torque word: "),
    ],
)
def test_a_defect_of_one_drive_is_found_there_alone(tested, defect, name, low, high, text):
    two = ("--axis", "J2", "--axis", "J3")
    _, reports, _, drives = tested(
        *two, code=7, prepare=lambda drives: defect(drives.handle.simulation.arms[0].drives[1])
    )
    assert [axis for axis, report in reports.items() if report["findings"]] == ["J2"]
    assert any(text in each for each in reports["J2"]["findings"])
    (figure,) = [each for each in reports["J2"]["figures"] if each["name"] == name]
    assert low <= figure["value"] <= high
    assert drives.stand_still()


@pytest.mark.slow
def test_the_motion_of_a_single_axis_obeys_the_override(tested):
    """While the others rest, J2 turns with a share of its speed of 0.0225 + 0.0075 + 0.0125 rad/s at most."""
    places = []

    def watched_positions(drives):
        (arm,) = drives.handle.simulation.arms
        answer = arm.drives[0].sync

        def sync():
            places.append([axis.position_rad for axis in arm.world.axes])
            answer()

        arm.drives[0].sync = sync

    tested("--axis", "J2", "--override", "50", prepare=watched_positions)
    speed_rad_s = np.abs(np.diff(places, axis=0)) / 0.01
    alone = (speed_rad_s[:, 1] > 0.002) & (np.delete(speed_rad_s, 1, axis=1).max(axis=1) < 1e-4)
    assert alone.sum() > 200
    assert 0.4 * 0.0425 < np.quantile(speed_rad_s[alone, 1], 0.99) < 0.6 * 0.0425


@pytest.mark.slow
@pytest.mark.parametrize(("axis", "named"), [("J3", True), ("J2", False)])
def test_a_failed_proof_ends_the_test_also_of_a_drive_that_is_not_tested(tested, place, axis, named):
    fault = '[[fault]]\nkind = "heartbeat_ignored"\nnode = 3\n'
    done, reports, _, drives = tested("--axis", axis, code=7, fault=fault)
    report = reports[axis]
    assert any("ignores the loss of the master" in text for text in report["findings"]) == named
    assert "J3 node 3" in done.stderr
    missing = {each["name"]: each["method"] for each in report["figures"] if each["value"] is None}
    assert {"quick_stop_time_s", "quick_stop_angle_rad", "fault_reaction_time_s", "torque_age_s"} <= missing.keys()
    assert "nothing moves any more" in missing["torque_age_s"]
    (box,) = (place.folder / "state" / "servo-gateway").glob("*.blackbox.h5")
    assert box.name in done.stderr
    assert "J3 node 3" in read_box(box).reason
    assert drives.stand_still()


@pytest.mark.slow
@pytest.mark.clock
def test_answers_of_disabled_drives_are_findings_of_the_drive_and_nothing_moves_without_a_reaction(tested, monkeypatch):
    """In real time, once more where this computer did not keep its time; whether it does has a test of its own."""
    monkeypatch.setattr(machine, "measure_lateness", lambda *_: [0.0])
    missed, reaction = "Missed TPDOs at 10 ms", "Controlword to reaction"
    expected = {"J2": [reaction.lower()], "J3": [reaction], "J4": [missed], "J5": []}

    def prepare(drives):
        (arm,) = drives.handle.simulation.arms
        before[:] = [axis.position_rad for axis in arm.world.axes]
        for number, name in ((1, "delayed_rpdo"), (2, "delayed_controlword"), (3, "every_second_sync")):
            act(arm.drives, fault_of(name, node=arm.drives[number].node_id))

    words = ("--axis", "J2", "--axis", "J3", "--axis", "J4", "--axis", "J5", "--pacing", "real")
    before, found = [], {}
    for _ in range(TRIES):
        (done, reports, out, drives), sleepers = watched(
            lambda: tested(*words, code=None, prepare=prepare, pacing="real"), STALL_S
        )
        found = {axis: [text.partition(":")[0] for text in report["findings"]] for axis, report in reports.items()}
        if found == expected or not sleepers.stalls:
            break
        shutil.rmtree(out)
    assert found == expected, sleepers
    assert done.exit_code == 7, done.output
    figures = {axis: {each["name"]: each for each in report["figures"]} for axis, report in reports.items()}
    assert 0.037 < figures["J3"]["controlword_to_reaction_s"]["value"] < 0.045
    assert 0.4 < figures["J4"]["missed_pdo_10ms"]["value"] < 0.6
    assert all("nothing moves" in figures[axis]["quick_stop_time_s"]["method"] for axis in reports)
    after = [axis.position_rad for axis in drives.handle.simulation.arms[0].world.axes]
    assert after == pytest.approx(before, abs=1e-4)
    assert drives.stand_still()


@pytest.mark.parametrize(
    ("more", "code", "text"),
    [(("--axis", "J9"), 2, "'J9' is not an axis of this arm"), (("--arm", "other"), 3, "other")],
)
def test_wrong_names_are_refused_before_anything_is_sent(tested, more, code, text):
    done, reports, _, drives = tested(*more, code=code)
    assert text in done.stderr
    assert not reports
    assert drives.handle.simulation.servers[0].sync_count == 0


def test_earlier_results_are_not_replaced(tested, place):
    (place.folder / "out").mkdir()
    (place.folder / "out" / "J2.json").write_text("{}")
    done, _, out, _ = tested("--axis", "J2", code=3)
    assert "not replaced" in done.stderr
    assert (out / "J2.json").read_text() == "{}"


def test_nothing_is_tested_without_a_yes(gateway, place, serve):
    drives = serve()
    done = gateway("check", place.cell, "--timing", "--bus", drives.bus, "-o", place.folder / "out", input="n\n")
    assert done.exit_code == 130
    assert not (place.folder / "out").exists()
    assert drives.handle.simulation.servers[0].sync_count == 0
