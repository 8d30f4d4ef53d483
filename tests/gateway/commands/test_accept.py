"""accept from tables of a simulated arm (torque by pinocchio): a right load passes, a wrong one fails, and refusals."""

from __future__ import annotations

import json
import re
import shutil
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pinocchio
import pytest
from click.testing import CliRunner

from gateway.cli import main
from gateway.data.rows import concatenate
from gateway.data.table import write_csv
from gateway.identify.workspace_error import EnteredLoad, ErrorFamily, fewest_poses, inferred_error, resolution
from gateway.model.robot import robot_from_urdf
from gateway.pipeline.workspace_acceptance import flange_equivalent
from gateway.result.result import EffectResult, LoadResult, read_result, to_json
from tests.data.arms import peer_of
from tests.data.resting_arm import LIMIT, POSES, SMALL, two_sided

UNSEEN = np.random.default_rng(8).uniform(-LIMIT, LIMIT, (10, 6))
TOOL = (4.0, 0.03, 0.02, 0.10)
TOLERANCE = "3%"


@pytest.fixture(scope="module")
def identified(tmp_path_factory):
    """A folder with the cell and the result of an identification."""
    folder = tmp_path_factory.mktemp("identified")
    for name in ("cell.toml", "robot.urdf"):
        shutil.copy(SMALL / name, folder / name)
    write_csv(concatenate([two_sided("none", None), two_sided("tool", TOOL, start_s=300.0)]), folder / "seen.csv")
    words = ["estimate", folder / "seen.csv", "--cell", folder / "cell.toml", "--json", folder / "result.json"]
    done = CliRunner().invoke(main, [str(word) for word in words])
    assert done.exit_code == 0, done.output
    return folder


@pytest.fixture
def accept(identified, tmp_path):
    def run(*more, content=None, result=None, tolerance=TOLERANCE):
        write_csv(two_sided("tool", TOOL, UNSEEN, 2000.0, 7) if content is None else content, tmp_path / "unseen.csv")
        load = identified / "result.json"
        if result is not None:
            load = tmp_path / "changed.json"
            load.write_text(to_json(result), encoding="utf-8")
        words = ["accept", identified / "cell.toml", load, "--from", tmp_path / "unseen.csv", "-o", tmp_path]
        words += [*more, *(() if tolerance is None else ("--tolerance", tolerance))]
        return CliRunner(env={"COLUMNS": "200"}).invoke(main, [str(word) for word in words])

    return run


def test_a_right_load_passes_with_map_page_and_junit(accept, tmp_path):
    done = accept("--json", tmp_path / "a.json", "--junit", tmp_path / "a.xml")
    assert done.exit_code == 0, done.output
    answer = json.loads((tmp_path / "a.json").read_text())
    assert answer["outcome"] == "pass"
    assert answer["probability_of_wrong_decision"] <= 0.02
    assert len(answer["poses"]) == len(UNSEEN)
    assert np.abs([pose["residual_nm"] for pose in answer["poses"]]).max() < max(answer["tolerance_nm"])
    page = (tmp_path / "accept.html").read_text(encoding="utf-8")
    assert "Pass: the torque error is within the tolerance over the whole workspace" in page
    assert page.count('class="map-within"') > 500
    assert page.count('class="map-measured"') == len(UNSEEN)
    suite = ElementTree.parse(tmp_path / "a.xml").getroot()
    assert not list(suite.iter("failure"))


def test_without_a_tolerance_it_is_5_percent_of_the_torque_limits(accept, tmp_path):
    accept("--hold-to-run", "--json", tmp_path / "a.json", tolerance=None)
    answer = json.loads((tmp_path / "a.json").read_text())
    assert answer["tolerance_nm"] == pytest.approx((0.05 * torque_limits()).tolist())


def heavier(result, factor):
    (load,) = result.loads
    return replace(result, loads=(replace(load, mass_kg=factor * load.mass_kg),), sha256=None)


def test_a_load_entered_too_heavy_fails_and_is_named(accept, identified, tmp_path):
    result = heavier(read_result(identified / "result.json"), 1.8)
    done = accept("--json", tmp_path / "a.json", "--junit", tmp_path / "a.xml", result=result)
    assert done.exit_code == 7, done.output
    answer = json.loads((tmp_path / "a.json").read_text())
    assert (answer["outcome"], answer["likeliest_error"]) == ("fail", "load")
    # 3.2 kg too much: the force at the flange is their weight
    assert np.median([pose["flange_force_n"] for pose in answer["poses"]]) == pytest.approx(3.2 * 9.81, rel=0.3)
    (failure,) = ElementTree.parse(tmp_path / "a.xml").getroot().iter("failure")
    assert failure.get("type") == "fail"


@pytest.mark.parametrize("joint", [2, 3, 5])
def test_a_spring_that_is_in_no_model_fails(accept, tmp_path, joint):
    limit = 0.03 * torque_limits()[joint - 1]

    def spring(q):
        out = np.zeros_like(q)
        out[:, joint - 1] = 2.0 * limit * np.tanh(2.0 * q[:, joint - 1])
        return out

    done = accept("--json", tmp_path / "a.json", content=two_sided("tool", TOOL, UNSEEN, 2000.0, 7, error=spring))
    assert done.exit_code == 7, done.output
    assert json.loads((tmp_path / "a.json").read_text())["outcome"] == "fail"


def torque_limits():
    from gateway.cell.config import load_cell

    return np.array([axis.torque_limit_nm for axis in load_cell(SMALL / "cell.toml").cell.arm[0].axis])


def test_poses_that_were_seen_do_not_count(accept):
    done = accept(content=two_sided("tool", TOOL, POSES, 2000.0, 7))
    assert done.exit_code == 6, done.output
    assert "no unseen pose" in done.output


@pytest.mark.parametrize("tolerance", ["3", "0%", "-1%", "200%", "x", "1,2,3", "nan%", "1,1,1,1,1,inf"])
def test_a_tolerance_that_is_none_is_a_usage_error(accept, tolerance):
    done = accept(tolerance=tolerance)
    assert done.exit_code == 3, done.output
    assert "--tolerance" in done.output


def changed_result(identified, **changes):
    return replace(read_result(identified / "result.json"), sha256=None, **changes)


def test_what_cannot_be_predicted_is_refused_before_anything_moves(accept, identified):
    for changes, code, says in (
        ({"bare": None}, 6, "unloaded arm"),
        ({"effects": (EffectResult("balancer_spring", (2,)),)}, 6, "balancer_spring"),
        ({"effects": (EffectResult("thermal_drift", (2,), {"per_s": 1e-4}),)}, 6, "thermal_drift"),
        ({"effects": (CABLE,), "verdict": "undecided"}, 6, "does not decide"),
        ({"loads": (LoadResult("tool", refused="contradicts itself"),)}, 6, "contradicts itself"),
        ({"loads": ()}, 3, "--load"),
        ({"noise_floor_nm": (float("nan"),) * 6}, 6, "noise floor"),
    ):
        done = accept(result=changed_result(identified, **changes))
        assert done.exit_code == code, done.output
        assert says in done.output
    assert accept("--load", "other").exit_code == 3
    beyond = accept(result=heavier(read_result(identified / "result.json"), 1000.0))
    assert beyond.exit_code == 3, beyond.output


CABLE = EffectResult("cable_torque", (5,), {"stiffness_nm_rad": 30.0, "neutral_rad": 0.3, "harmonic": 1.0})


def cable(q, share=1.0):
    out = np.zeros_like(q)
    out[:, 4] = share * 30.0 * np.sin(q[:, 4] - 0.3)
    return out


@pytest.mark.parametrize(("share", "outcome"), [(1.0, "pass"), (0.0, "fail"), (1.6, "fail")])
def test_the_torque_of_an_effect_of_the_result_is_predicted(accept, identified, tmp_path, share, outcome):
    """The cable of the result is there, was taken off, or pulls harder."""
    content = two_sided("tool", TOOL, UNSEEN, 2000.0, 7, error=lambda q: cable(q, share))
    result = changed_result(identified, effects=(CABLE,), verdict="improved")
    done = accept("--json", tmp_path / "a.json", content=content, result=result)
    assert done.exit_code == (0 if outcome == "pass" else 7), done.output
    answer = json.loads((tmp_path / "a.json").read_text())
    assert answer["outcome"] == outcome
    assert outcome == "pass" or answer["likeliest_error"] == "spring or cable on J5"


@pytest.mark.slow
def test_a_load_diagnosed_beside_a_cable_passes(tmp_path):
    """diagnose names the cable and states the unloaded arm without it."""
    for name in ("cell.toml", "robot.urdf"):
        text = (SMALL / name).read_text(encoding="utf-8")
        # the rows are those of gears without losses
        text = re.sub(r"gear_efficiency = \{ value = [\d.]+", "gear_efficiency = { value = 1.0", text)
        (tmp_path / name).write_text(text, encoding="utf-8")
    poses = np.random.default_rng(4).uniform(-LIMIT, LIMIT, (14, 6))
    seen = [two_sided("none", None, poses, error=cable), two_sided("tool", TOOL, poses, start_s=600.0, error=cable)]
    write_csv(concatenate(seen), tmp_path / "seen.csv")
    write_csv(two_sided("tool", TOOL, UNSEEN, 2000.0, 7, error=cable), tmp_path / "unseen.csv")
    cell, result = tmp_path / "cell.toml", tmp_path / "result.json"
    done = CliRunner().invoke(
        main, ["diagnose", str(tmp_path / "seen.csv"), "--cell", str(cell), "--json", str(result)]
    )
    assert done.exit_code == 0, done.output
    assert [effect.name for effect in read_result(result).effects] == ["cable_torque"]
    words = ["accept", str(cell), str(result), "--from", str(tmp_path / "unseen.csv")]
    done = CliRunner().invoke(main, [*words, "--tolerance", TOLERANCE, "--json", str(tmp_path / "a.json")])
    assert done.exit_code == 0, done.output
    worst = np.abs([pose["residual_nm"] for pose in json.loads((tmp_path / "a.json").read_text())["poses"]]).max(axis=0)
    assert (worst < 0.1 * 0.03 * torque_limits()).all()
    later = ["estimate", str(tmp_path / "unseen.csv"), "--cell", str(cell), "--bare", str(result)]
    refused = CliRunner().invoke(main, later)
    assert refused.exit_code == 3
    assert "cable_torque" in refused.output


def test_the_force_at_the_flange_gives_its_own_torque():
    robot = robot_from_urdf((SMALL / "robot.urdf").read_text(encoding="utf-8"), "small")
    model, _ = peer_of((SMALL / "robot.urdf").read_text(encoding="utf-8"))
    data = model.createData()
    force, moment = np.array([10.0, -4.0, 7.0]), np.array([0.5, 1.0, -2.0])
    q = np.array([[0.3, -0.5, 0.8, 0.4, 0.9, -0.2]])
    jacobian = pinocchio.computeFrameJacobian(
        model, data, q[0], model.nframes - 1, pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
    )
    bare = read_bare(robot)
    found = flange_equivalent(EnteredLoad(robot, bare, LoadResult("x")), q, (jacobian.T @ [*force, *moment])[None])
    assert found[0][0] == pytest.approx(np.linalg.norm(force), rel=1e-6)
    assert found[1][0] == pytest.approx(np.linalg.norm(moment), rel=1e-6)


def read_bare(robot):
    from gateway.result.result import Bare

    return Bare(robot.name, (0, 0, -9.80665), (), (), (), (), (), (0.0,) * 6)


def test_the_design_resolves_every_error_with_few_poses():
    rng = np.random.default_rng(3)
    q = rng.uniform(-1, 1, (200, 2))
    shapes = {"a": [np.ones(200)], "b": [q[:, 0], q[:, 1]], "c": [q[:, 0] ** 2]}
    families = [
        ErrorFamily(name, np.stack([np.stack(columns, 1), np.zeros((200, len(columns)))], 1))
        for name, columns in shapes.items()
    ]
    noise = np.array([0.1, 0.1])
    chosen = fewest_poses(families, noise, np.arange(0, 200, 2), 12)
    assert len(chosen) <= 4
    assert all(row % 2 == 0 for row in chosen)
    assert resolution(families, noise, chosen) <= 0.2
    assert resolution(families, noise, chosen[:1]) > 0.2


def test_the_probability_is_that_of_the_posterior_of_one_amplitude():
    # one error that is 1 everywhere, one pose, noise 0.1: the amplitude's posterior is closed form
    families = [ErrorFamily("offset", np.ones((5, 1, 1)))]
    for residual, outcome in ((0.0, "pass"), (2.0, "fail"), (1.0, "cannot tell")):
        found = inferred_error(families, np.array([0]), np.array([[residual]]), np.array([0.1]))
        assert found.outcome == outcome, residual
    assert found.exceeds == pytest.approx(0.5, abs=0.15)
    # the prior pulls the mean by less than the noise, and the error is the same at every posture
    assert found.mean[:, 0] == pytest.approx([found.mean[4, 0]] * 5)
    assert found.mean[4, 0] == pytest.approx(1.0, abs=0.1)
