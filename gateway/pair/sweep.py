"""Small back-and-forth sweep that cancels dry friction in the force measurement at a taught point.

Friction cancels over a period only for joints that move in both directions. Along the path a joint may barely move, so
the part is moved and rotated such that all joints of both arms move.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from gateway.pair.inverse import turns_at
from gateway.pair.pair_cell import PairCell
from gateway.pair.transform import Floats, cross_matrix, exp_rotation, inverse, pose

#: Lever that converts rotations to lengths [m].
LEVER_M = 0.2


def directions() -> Floats:
    """Twists (364, 6) of length 1, a turn counted at the lever: every mixture of the six axes but for the sign."""
    mixtures = np.array([mixture for mixture in product((0.0, 1.0, -1.0), repeat=6) if any(mixture)])
    first = mixtures[np.arange(len(mixtures)), np.argmax(mixtures != 0.0, axis=1)]
    kept = mixtures[first > 0.0]
    return kept / np.linalg.norm(kept, axis=1)[:, None] / np.repeat([1.0, LEVER_M], 3)


def liveliest_twist(cell: PairCell, command: Floats, q_rad: tuple[Floats, Floats]) -> tuple[Floats, float]:
    """Return the twist of the part that maximises the smallest joint movement.

    Parameters
    ----------
    cell : PairCell
    command : array of shape (4, 4)
        Of the master's gripper.
    q_rad : two arrays of shape (N,)
        Joint angles of both arms there.

    Returns
    -------
    tuple
        Twist (6,) of the part about its centre, world axes, length 1 [m/m, rad/m]; how far the joint that turns least
        turns with it [rad/m].
    """
    centre = _centre(cell, command)
    twists = directions()
    least = np.full(len(twists), np.inf)
    for arm, q in zip(cell.arms, q_rad, strict=True):
        lever = (arm.world_from_base @ arm.chain.poses(q[None])[0][0])[:3, 3] - centre
        to_base = np.kron(np.eye(2), arm.world_from_base[:3, :3].T)
        at_tip = np.eye(6)
        at_tip[:3, 3:] = -cross_matrix(lever)
        rates = turns_at(arm.chain, q, to_base @ at_tip @ twists.T)
        least = np.minimum(least, np.abs(rates).min(axis=0))
    best = int(np.argmax(least))
    return twists[best], float(least[best])


def swept(cell: PairCell, command: Floats, twist: Floats, offsets_m: Floats) -> Floats:
    """Return the master's commands (n, 4, 4) that move the part from a command along a twist by offsets (n,) [m]."""
    base = cell.arms[0].world_from_base
    centre = pose(np.eye(3), _centre(cell, command))
    back = inverse(base)
    moved = [pose(exp_rotation(twist[3:] * offset_m), twist[:3] * offset_m) for offset_m in offsets_m]
    return np.array([back @ centre @ each @ inverse(centre) @ base @ command for each in moved])


def _centre(cell: PairCell, command: Floats) -> Floats:
    first = cell.arms[0]
    return (first.world_from_base @ command @ inverse(first.part_from_tip))[:3, 3]
