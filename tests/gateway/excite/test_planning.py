"""A plan of motions keeps every limit, judged by differences of its positions and by an independent library."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio  # pyright: ignore[reportMissingImports]
import pytest

from gateway.errors import InputError, PlanRefused
from gateway.excite import random_series, series_choice
from gateway.excite.excitation import MovingPlan, Series
from gateway.excite.plan_file import excitation_of, plan_as_plain, read_plan
from gateway.excite.planning import MovingRequest, check_moving_plan, make_moving_plan
from gateway.feedforward.load import rated_load
from gateway.model.arm_model import arm_robot, robot_text
from gateway.model.kinematics import flange_frames
from gateway.motion.workspace import workspace_of
from gateway.result.origin import sealed
from tests.data.arms import carrying, peer_of, torque_of

REQUEST = MovingRequest(choice="random")


@pytest.fixture(scope="module", autouse=True)
def few():
    """Few random motions to choose from: enough for what is asked here, and fast."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(random_series, "RANDOM", 16)
        yield


@pytest.fixture(scope="module")
def config(small_cell) -> Any:
    return small_cell.cell.arm[0]


@pytest.fixture(scope="module")
def plan(small_cell) -> MovingPlan:
    return make_moving_plan(small_cell, None, REQUEST)


def series_of(plan: MovingPlan) -> Series:
    (series,) = plan.excitations
    assert isinstance(series, Series)
    return series


def larger(plan: MovingPlan, factor: float) -> MovingPlan:
    series = series_of(plan)
    grown = replace(series, cosine_rad=factor * series.cosine_rad, sine_rad=factor * series.sine_rad)
    return replace(plan, excitations=(grown,))


def differences(series: Series) -> list[np.ndarray]:
    """Positions, speeds, accelerations and jerks by differences of positions over one period."""
    step_s = series.period_s / 4000
    values = [series.at(np.arange(-3, 4003) * step_s)[0]]
    for _ in range(3):
        values.append(np.diff(values[-1], axis=0) / step_s)
    return values


def test_no_limit_of_a_joint_is_exceeded_and_one_is_nearly_reached(plan: MovingPlan, config) -> None:
    q, qd, qdd, jerk = differences(series_of(plan))
    limits = np.array([axis.position_limit_rad for axis in config.axis])
    assert (q >= limits[:, 0]).all()
    assert (q <= limits[:, 1]).all()
    assert (np.abs(qd) <= [axis.speed_limit_rad_s for axis in config.axis]).all()
    assert (np.abs(qdd) <= [axis.acceleration_rad_s2 for axis in config.axis]).all()
    assert (np.abs(jerk) <= [axis.jerk_rad_s3 for axis in config.axis]).all()


def test_the_torque_of_the_heaviest_load_stays_inside_its_limit(small_cell, plan: MovingPlan, config) -> None:
    text = robot_text(small_cell, config)
    load = rated_load(config, arm_robot(small_cell, config))
    bare, _ = peer_of(text)
    q, qd, qdd, _ = series_of(plan).at(np.linspace(0.0, 10.0, 801))
    limit = np.array([axis.torque_limit_nm for axis in config.axis])
    efficiency = np.array([axis.gear_efficiency.value for axis in config.axis])
    rotor = np.array([axis.rotor_inertia_kg_m2.value for axis in config.axis])
    for model in (bare, carrying(bare, load.mass_kg, load.com_m, load.inertia_kg_m2)):
        torque = torque_of(model, q, qd, qdd)
        assert (np.abs(torque / efficiency) + rotor * np.abs(qdd) < 0.9 * limit).all()


def test_a_gripper_that_holds_little_is_heeded(small_cell, config) -> None:
    """Acceleration of the load's centre by second differences of its places along the motion, in pinocchio."""
    gentle = config.model_copy(update={"load_acceleration_m_s2": 0.4})
    cell = small_cell.cell.model_copy(update={"arm": (gentle,)})
    plan = make_moving_plan(small_cell.model_copy(update={"cell": cell}), None, REQUEST)
    model, data = peer_of(robot_text(small_cell, config))
    com_m = np.array(config.rated_load_com_m)
    step_s = 0.004
    places = []
    for q in series_of(plan).at(np.arange(0.0, 10.0, step_s))[0]:
        pinocchio.forwardKinematics(model, data, q)
        places.append(data.oMi[6].act(com_m))
    acceleration = np.diff(places, 2, axis=0) / step_s**2
    assert 0.2 < np.linalg.norm(acceleration, axis=1).max() < 0.4
    workspace = workspace_of(config, arm_robot(small_cell, config))
    with pytest.raises(PlanRefused, match="load acceleration"):
        check_moving_plan(larger(plan, 1.3), workspace, gentle)


def test_a_motion_that_meets_a_box_is_refused(small_cell, plan: MovingPlan, config) -> None:
    """A box about the place of the flange half a period on, which is elsewhere at the start."""
    robot = arm_robot(small_cell, config)
    series = series_of(plan)
    positions = flange_frames(robot, series.at(np.linspace(0.0, 10.0, 100))[0])[:, :3, 3]
    far = positions[np.argmax(np.linalg.norm(positions - positions[0], axis=1))]
    check_moving_plan(plan, workspace_of(config, robot), config)
    box = config.keep_out[0].model_copy(update={"min_m": tuple(far - 0.01), "max_m": tuple(far + 0.01)})
    boxed = config.model_copy(update={"keep_out": (*config.keep_out, box)})
    with pytest.raises(PlanRefused, match="keep_out box 3|closer than"):
        check_moving_plan(plan, workspace_of(boxed, robot), boxed)


@pytest.mark.slow
def test_improving_makes_the_promise_better_and_keeps_the_limits(small_cell, config, monkeypatch) -> None:
    for steps, few in (("TRIES", 1), ("FIRST_STEPS", 8), ("MORE_STEPS", 8)):
        monkeypatch.setattr(series_choice, steps, few)
    plan = make_moving_plan(small_cell, None, MovingRequest())
    best = make_moving_plan(small_cell, None, REQUEST)
    assert plan.expected["over_random"] < 0.95
    stds, drawn = (
        np.array([load["mass_std_kg"], *load["com_std_m"], *load["inertia_std_kg_m2"]])
        for load in (plan.expected["load"], best.expected["load"])
    )
    assert np.exp(np.log(stds / drawn).mean()) == pytest.approx(plan.expected["over_random"], rel=0.02)
    _, qd, qdd, _ = differences(series_of(plan))
    assert (np.abs(qd) <= [axis.speed_limit_rad_s for axis in config.axis]).all()
    assert (np.abs(qdd) <= [axis.acceleration_rad_s2 for axis in config.axis]).all()


@pytest.fixture(scope="module")
def swept(small_cell) -> MovingPlan:
    return make_moving_plan(small_cell, None, MovingRequest(purpose=("friction",)))


def test_sweeps_turn_every_joint_steadily_in_both_directions_inside_its_limits(swept: MovingPlan, config) -> None:
    assert [sweep.joint for sweep in swept.excitations] == [1, 2, 3, 4, 5, 6]
    for sweep in swept.excitations:
        motion, j = sweep.motion(0.004), sweep.joint - 1
        others = np.delete(motion.q_rad, j, axis=1)
        assert (others == np.delete(np.asarray(sweep.start_rad), j)).all()
        assert motion.q_rad[-1] == pytest.approx(np.asarray(sweep.start_rad))
        speeds = np.diff(motion.q_rad[:, j]) / 0.004
        axis = config.axis[j]
        assert np.abs(speeds).max() <= axis.speed_limit_rad_s
        assert np.abs(np.diff(speeds)).max() / 0.004 <= axis.acceleration_rad_s2
        low, high = axis.position_limit_rad
        assert low <= motion.q_rad[:, j].min() < motion.q_rad[:, j].max() <= high
        for share in (0.02, 0.1, 0.5):
            for side in (-1, 1):
                steady = np.isclose(speeds, side * share * 0.95 * axis.speed_limit_rad_s, rtol=1e-3)
                assert 0.004 * steady.sum() > 1.5
        assert sweep.period_s == pytest.approx(motion.duration_s, abs=12 * 0.004)
    friction = swept.expected["friction"]
    assert len(friction["coulomb_std_nm"]) == len(friction["viscous_std_nm_s_rad"]) == 6
    assert None not in friction["coulomb_std_nm"]


def test_a_file_of_sweeps_is_read_as_it_was_written(swept: MovingPlan, config, tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(plan_as_plain(swept)))
    read = read_plan(path, config)
    assert plan_as_plain(read) == plan_as_plain(swept)
    assert np.array_equal(read.excitations[1].motion(0.01).q_rad, swept.excitations[1].motion(0.01).q_rad)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [("joint", 7, "does not exist"), ("ends_rad", [0.1], "one end"), ("speeds_rad_s", [0.0] * 6, "positive")],
)
def test_a_sweep_that_is_none_is_refused(swept: MovingPlan, key: str, value, said: str) -> None:
    with pytest.raises(InputError, match=said):
        excitation_of(swept.excitations[0].plain() | {key: value}, "plan.json")


def test_an_arm_without_space_is_refused_with_the_reason(small_cell, config) -> None:
    weak = tuple(axis.model_copy(update={"torque_limit_nm": min(axis.torque_limit_nm, 30.0)}) for axis in config.axis)
    walled = config.model_copy(update={"max_load_kg": 10.0, "axis": weak})
    cell = small_cell.cell.model_copy(update={"arm": (walled,)})
    with pytest.raises(PlanRefused, match="holding torque|limits"):
        make_moving_plan(small_cell.model_copy(update={"cell": cell}), None, REQUEST)


def test_a_motion_that_is_too_large_is_refused_with_the_limit(small_cell, plan: MovingPlan, config) -> None:
    workspace = workspace_of(config, arm_robot(small_cell, config))
    check_moving_plan(plan, workspace, config)
    with pytest.raises(PlanRefused, match=r"motion 'load'.*(J\d|joint)"):
        check_moving_plan(larger(plan, 3.0), workspace, config)


@pytest.mark.slow
def test_the_same_request_gives_the_same_motion(small_cell, plan: MovingPlan) -> None:
    again = make_moving_plan(small_cell, None, REQUEST)
    assert plan_as_plain(again) == plan_as_plain(plan)
    other = make_moving_plan(small_cell, None, replace(REQUEST, seed=2))
    assert plan_as_plain(other) != plan_as_plain(plan)


@pytest.mark.parametrize("wrong", [{"period_s": 0.5}, {"period_s": 60.0}, {"periods": 1}])
def test_an_uninformative_period_is_refused(small_cell, wrong: dict[str, Any]) -> None:
    with pytest.raises(PlanRefused, match="period"):
        make_moving_plan(small_cell, None, replace(REQUEST, **wrong))


def test_a_plan_file_is_read_as_it_was_written(plan: MovingPlan, config, tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(plan_as_plain(plan)))
    read = read_plan(path, config)
    assert plan_as_plain(read) == plan_as_plain(plan)
    at = np.linspace(0.0, 10.0, 7)
    assert np.array_equal(series_of(read).at(at)[0], series_of(plan).at(at)[0])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda plan: plan["excitations"][0]["cosine_rad"][0].__setitem__(0, 0.5), "edited"),
        (lambda plan: plan.pop("sha256"), "sha256"),
        (lambda plan: plan.__setitem__("kind", "rest_plan"), "edited"),
    ],
)
def test_an_edited_plan_is_refused(plan: MovingPlan, config, tmp_path: Path, change, said: str) -> None:
    plain = json.loads(json.dumps(plan_as_plain(plan)))
    change(plain)
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(plain))
    with pytest.raises(InputError, match=said):
        read_plan(path, config)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("cosine_rad", [[0.1, 0.0, 0.0, 0.0, 0.0]] * 6, "rest"),
        ("sine_rad", [[0.1, 0.0]] * 5, "each joint"),
        ("periods", 0, "positive"),
        ("period_s", "ten", "period_s"),
        ("kind", "dance", "dance"),
    ],
)
def test_a_motion_that_is_none_is_refused(plan: MovingPlan, config, tmp_path: Path, key: str, value, said: str) -> None:
    series = series_of(plan)
    changed = series.plain() | {key: value}
    path = tmp_path / "plan.json"

    class Changed:
        def plain(self) -> dict[str, Any]:
            return changed

    broken: Any = (Changed(),)
    path.write_text(json.dumps(plan_as_plain(replace(plan, excitations=broken))))
    with pytest.raises(InputError, match=said):
        read_plan(path, config)


REST_POSES = [{"pose": k, "purpose": "fit", "q_rad": [0.1 * k] * 6} for k in range(4)]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"poses": [REST_POSES[0] | {"purpose": [1]}]}, r"poses\[0\].purpose"),
        ({"poses": [REST_POSES[0] | {"purpose": "validation"}]}, "'fit'"),
        ({"poses": [REST_POSES[0] | {"q_rad": [0.0] * 5}, *REST_POSES]}, "5 or 6 axes"),
        ({"poses": []}, "'fit'"),
        ({"arm": "left"}, "arm 'left'"),
        ({"duration_s": None}, "duration"),
        ({"sha256": "0"}, "edited"),
        ({"kind": "follow"}, "kind.*rest_plan"),
    ],
)
def test_a_plan_of_rest_poses_that_is_none_is_refused(
    config, tmp_path: Path, change: dict[str, Any], said: str
) -> None:
    path = tmp_path / "plan.json"
    plan = {"schema": 1, "kind": "rest_plan", "arm": config.name, "duration_s": 60.0, "poses": REST_POSES}
    path.write_text(json.dumps(sealed(plan)))
    assert [pose.q_rad[0] for pose in read_plan(path, config).poses] == [pose["q_rad"][0] for pose in REST_POSES]
    path.write_text(json.dumps(sealed(plan | change) | {key: change[key] for key in change if key == "sha256"}))
    with pytest.raises(InputError, match=said):
        read_plan(path, config)
