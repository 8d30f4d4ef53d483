"""An independent collision check of paths: PyBullet with the URDF, floor, wall, column and boxes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pybullet

from benchmarks.space.cells import DrawnCell
from gateway.model.kinematics import link_frames
from gateway.model.robot import Robot

STEP_M = 0.005
#: Stretches whose length is measured.
COARSE_RAD = 0.05
#: Deeper than this is a touch.
DEPTH_M = 1e-6
SAMPLES = 200


class Judge:
    """Finds what touches at a posture. Use as a context manager.

    Left out, by its own test over random postures: neighbours, and pairs that touch at all angles. Of floor, wall,
    column and boxes that holds for the base and the first link only.
    """

    def __init__(self, cell: DrawnCell, floor_m: float) -> None:
        self._client = pybullet.connect(pybullet.DIRECT)
        flags = pybullet.URDF_USE_SELF_COLLISION | pybullet.URDF_USE_SELF_COLLISION_EXCLUDE_PARENT
        # cylinders and boxes as they are, not as hulls with a margin of 1 mm
        flags |= pybullet.URDF_USE_IMPLICIT_CYLINDER
        self._arm = pybullet.loadURDF(str(cell.urdf), useFixedBase=True, flags=flags, physicsClientId=self._client)
        count = pybullet.getNumJoints(self._arm, physicsClientId=self._client)
        infos = [pybullet.getJointInfo(self._arm, joint, physicsClientId=self._client) for joint in range(count)]
        self._joints = [info[0] for info in infos if info[2] == pybullet.JOINT_REVOLUTE]
        self._names = {-1: "base", **{info[0]: info[12].decode() for info in infos}}
        self._limits = np.array([(info[8], info[9]) for info in infos if info[2] == pybullet.JOINT_REVOLUTE])
        self._things: dict[int, str] = {}
        self._stand("floor", self._plane(cell.upward), floor_m * np.array(cell.upward))
        if np.dot(cell.upward, cell.outward) < np.cos(np.pi / 4):
            self._stand("wall", self._plane(cell.outward), np.zeros(3))
        if cell.pedestal_m is not None:
            height = -floor_m / cell.upward[2]
            shape = pybullet.createCollisionShape(
                pybullet.GEOM_CYLINDER, radius=cell.pedestal_m, height=height, physicsClientId=self._client
            )
            self._stand("column", shape, np.array([0, 0, -height / 2]))
        for number, (low, high) in enumerate(cell.boxes_m, start=1):
            half = (np.array(high) - low) / 2
            shape = pybullet.createCollisionShape(
                pybullet.GEOM_BOX, halfExtents=half.tolist(), physicsClientId=self._client
            )
            self._stand(f"box {number}", shape, (np.array(high) + low) / 2)
        for body in (self._arm, *self._things):
            for link in range(-1, pybullet.getNumJoints(body, physicsClientId=self._client)):
                # hulls are rounded by a margin of 1 mm otherwise
                pybullet.changeDynamics(body, link, collisionMargin=0.0, physicsClientId=self._client)
        self._left_out = self._always()

    def __enter__(self) -> Judge:
        return self

    def __exit__(self, *_: object) -> None:
        pybullet.disconnect(self._client)

    def _plane(self, normal: tuple[float, float, float]) -> int:
        return pybullet.createCollisionShape(pybullet.GEOM_PLANE, planeNormal=normal, physicsClientId=self._client)

    def _stand(self, name: str, shape: int, place: np.ndarray) -> None:
        body = pybullet.createMultiBody(0, shape, basePosition=place.tolist(), physicsClientId=self._client)
        self._things[body] = name

    def touches(self, q_rad: np.ndarray) -> set[tuple[str, str]]:
        """Names of the two of everything that touches."""
        return self._contacts(q_rad) - self._left_out

    def _contacts(self, q_rad: np.ndarray) -> set[tuple[str, str]]:
        for joint, value in zip(self._joints, q_rad, strict=True):
            pybullet.resetJointState(self._arm, joint, float(value), physicsClientId=self._client)
        pybullet.performCollisionDetection(physicsClientId=self._client)
        found = set()
        for contact in pybullet.getContactPoints(bodyA=self._arm, physicsClientId=self._client):
            if contact[8] < -DEPTH_M:
                first, other = self._named(contact[1], contact[3]), self._named(contact[2], contact[4])
                found.add((min(first, other), max(first, other)))
        return found

    def _named(self, body: int, link: int) -> str:
        return self._names[link] if body == self._arm else self._things[body]

    def _always(self) -> set[tuple[str, str]]:
        random = np.random.default_rng(5)
        drawn = random.uniform(self._limits[:, 0], self._limits[:, 1], (SAMPLES, len(self._limits)))
        counted: dict[tuple[str, str], int] = {}
        for q_rad in drawn:
            for pair in self._contacts(q_rad):
                counted[pair] = counted.get(pair, 0) + 1
        own = set(self._names.values())
        return {
            pair
            for pair, count in counted.items()
            if count == SAMPLES and (set(pair) <= own or {"base", "link_1"} & set(pair))
        }


def sampled(path_rad: np.ndarray, robot: Robot, size_m: float) -> Iterator[np.ndarray]:
    """Postures along a path (n, N) of straight joint motions, no point of the arm more than `STEP_M` from the next.

    How far a stretch leads is measured at its points, `size_m` about the origin of every link to all sides.
    """
    around = np.vstack([np.eye(3), -np.eye(3)]) * size_m
    for start, end in zip(path_rad[:-1], path_rad[1:], strict=True):
        coarse = max(int(np.ceil(np.abs(end - start).max() / COARSE_RAD)), 1)
        frames = link_frames(robot, start + np.linspace(0, 1, coarse + 1)[:, None] * (end - start))
        points = frames[:, :, None, :3, 3] + np.einsum("nlij,pj->nlpi", frames[:, :, :3, :3], around)
        moved = np.linalg.norm(np.diff(points, axis=0), axis=3).max(axis=(1, 2))
        for row, length in enumerate(moved):
            count = max(int(np.ceil(length / STEP_M)), 1)
            for share in (row + np.arange(count) / count) / coarse:
                yield start + share * (end - start)
    yield path_rad[-1]
