"""Compliance of the hands: of gears, estimated from cycles with different commands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gateway.pair.inverse import GearChain, Hand
from gateway.pair.joint_targets import JointFollower
from gateway.pair.pair_cell import load_pair

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
STATED = np.repeat([4e5, 4e3], 3)
TURN_RAD = 1e-6
#: Of the gears [rad/Nm], from 4e5 to 2.5e4 Nm/rad.
GEARS = {
    6: 1.0 / np.array([4e5, 4e5, 2.5e5, 6e4, 4e4, 2.5e4]),
    7: 1.0 / np.array([4e5, 4e5, 3e5, 2.5e5, 6e4, 4e4, 2.5e4]),
}


@pytest.fixture(scope="module", params=["pair/cell.toml", "pair-unequal/seven-six.toml"])
def pair(request):
    """Hands, bases, and the compliance (M, 6, 6) at the slave's fingertip from numerically turned joints."""
    cell = load_pair(EXAMPLES / request.param)
    path = cell.path(3.0)
    joints = cell.joints(path)
    followers = tuple(JointFollower(arm, q) for arm, q in zip(cell.arms, joints, strict=True))
    bases = tuple(arm.world_from_base for arm in cell.arms)
    world = [base @ each.poses for base, each in zip(bases, followers, strict=True)]
    grasp = np.linalg.inv(world[0]) @ world[1]
    compliance = np.tile(np.diag(1.0 / STATED), (len(path), 1, 1))
    for index, (arm, q, base) in enumerate(zip(cell.arms, joints, bases, strict=True)):
        for gear, unit in zip(GEARS[arm.axes], np.eye(arm.axes), strict=True):
            ahead, behind = (base @ arm.chain.poses(q + side * TURN_RAD * unit)[0] for side in (1, -1))
            if index == 0:
                ahead, behind = ahead @ grasp, behind @ grasp
            turn = Rotation.from_matrix(ahead[:, :3, :3] @ np.swapaxes(behind[:, :3, :3], 1, 2)).as_rotvec()
            move = np.concatenate([(ahead - behind)[:, :3, 3], turn], axis=1) / (2 * TURN_RAD)
            back = bases[1][:3, :3]
            local = np.concatenate([move[:, :3] @ back, move[:, 3:] @ back], axis=1)
            compliance += gear * local[:, :, None] * local[:, None, :]
    return tuple(Hand(each.poses, each.jacobian) for each in followers), bases, compliance


def cycle(compliance: np.ndarray, needed: np.ndarray, command: np.ndarray) -> np.ndarray:
    """Wrench (M, 6) that is left when a hand that should move by `needed` is commanded by `command`."""
    return np.linalg.solve(compliance, (needed - command)[..., None])[..., 0]


def drawn(count: int, seed: int) -> np.ndarray:
    """A path (count, 6) of a few tenths of a millimetre and a milliradian that sways."""
    random = np.random.default_rng(seed)
    time = np.linspace(0.0, 2.0 * np.pi, count)[:, None]
    size = np.repeat([3e-4, 1e-3], 3)
    waves = [(random.standard_normal(6), random.uniform(0.0, 6.0, 6), times) for times in (1, 2, 3)]
    return sum(size * high * np.sin(times * time + phase) for high, phase, times in waves)


def test_nothing_but_what_is_stated_is_known_at_first(pair):
    hands, bases, _ = pair
    wrench = np.tile([10.0, 0.0, 0.0, 0.0, 0.0, 2.0], (len(hands[0].poses), 1))
    chain = GearChain(hands, bases, STATED)
    assert chain.move(wrench) == pytest.approx(wrench / STATED)
    chain.take(wrench * 0.0, wrench)
    assert chain.move(wrench) == pytest.approx(wrench / STATED)


def test_two_cycles_show_the_compliance_of_gears(pair):
    hands, bases, compliance = pair
    count = len(hands[0].poses)
    needed = drawn(count, 1)
    chain = GearChain(hands, bases, STATED)
    first = cycle(compliance, needed, 0.0 * needed)
    chain.take(0.0 * needed, first)
    second = 0.7 * chain.move(first)
    left = cycle(compliance, needed, second)
    chain.take(second, left)
    third = second + chain.move(left)
    after = cycle(compliance, needed, third)
    assert np.abs(after[:, :3]).max() < 0.1 * np.abs(left[:, :3]).max()
    assert (chain.joints_rad_nm >= 0.0).all()
    gears = [GEARS[hand.jacobian.shape[2]] for hand in hands]
    assert chain.joints_rad_nm.sum() == pytest.approx(np.concatenate(gears).sum(), rel=0.3)


def test_a_chain_as_stiff_as_stated_has_no_compliance(pair):
    hands, bases, _ = pair
    count = len(hands[0].poses)
    needed, stiff = drawn(count, 2), np.tile(np.diag(1.0 / STATED), (count, 1, 1))
    chain = GearChain(hands, bases, STATED)
    chain.take(0.0 * needed, cycle(stiff, needed, 0.0 * needed))
    chain.take(0.5 * needed, cycle(stiff, needed, 0.5 * needed))
    assert chain.joints_rad_nm == pytest.approx(np.zeros(sum(hand.jacobian.shape[2] for hand in hands)), abs=1e-8)
