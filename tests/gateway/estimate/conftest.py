"""An arm, and tables of it whose torques come from pinocchio, so that no formula of the estimators tests itself."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from gateway.model.robot import robot_from_urdf
from tests.data.arms import carrying, peer_of, torque_of
from tests.support.rigs.tables import make_table

# link: joint origin xyz, axis, mass, centre of mass
LINKS = (
    ((0.0, 0.0, 0.45), (0, 0, 1), 40.0, (0.05, 0.02, -0.1)),
    ((0.15, 0.0, 0.0), (0, 1, 0), 25.0, (0.02, -0.03, 0.3)),
    ((0.0, 0.0, 0.6), (0, 1, 0), 15.0, (0.1, 0.02, 0.08)),
    ((0.25, 0.0, 0.1), (1, 0, 0), 6.0, (0.15, 0.0, 0.01)),
    ((0.39, 0.0, 0.0), (0, 1, 0), 3.0, (0.02, 0.01, 0.0)),
    ((0.1, 0.0, 0.0), (1, 0, 0), 1.0, (0.01, 0.005, 0.0)),
)


def urdf() -> str:
    """URDF text of a 12 kg class arm with a spherical wrist; link_6 has its x axis along the flange."""
    parts = ['<robot name="twelve"><link name="link_0"/>']
    for i, (xyz, axis, mass, com) in enumerate(LINKS, start=1):
        say = "{:g} {:g} {:g}".format
        parts.append(
            f'<link name="link_{i}"><inertial><origin xyz="{say(*com)}"/><mass value="{mass:g}"/>'
            f'<inertia ixx="{0.02 * mass:g}" ixy="0" ixz="0" iyy="{0.03 * mass:g}" iyz="0" izz="{0.025 * mass:g}"/>'
            f'</inertial></link><joint name="joint_{i}" type="revolute"><parent link="link_{i - 1}"/>'
            f'<child link="link_{i}"/><origin xyz="{say(*xyz)}"/><axis xyz="{say(*axis)}"/>'
            '<limit lower="-2.8" upper="2.8" effort="800" velocity="2"/></joint>'
        )
    return "".join([*parts, "</robot>"])


BAND_NM = np.array([40.0, 50.0, 30.0, 8.0, 6.0, 4.0])


def assert_same(found, truth):
    """Value and standard deviation of [m, x, y, z] against the truth, of readings without noise.

    Constants and losses are known to some percent, whatever the noise: a fit ends where a step moves none of them by a
    tenth of that.
    """
    value, std = found
    assert np.all(np.abs(value - truth) < 0.15 * std + 1e-5 * np.abs(truth)), (value, std, truth)


@dataclass
class Arm:
    """Pinocchio's model of the arm, with a body on the flange."""

    text: str = field(default_factory=urdf)
    band_nm: np.ndarray = field(default_factory=lambda: BAND_NM)

    @property
    def robot(self):
        return robot_from_urdf(self.text, "twelve.urdf")

    def model(self, load=None, gravity=(0.0, 0.0, -9.80665), inertia=((0.0,) * 3,) * 3):
        model, _ = peer_of(self.text, gravity)
        return model if load is None else carrying(model, load[0], load[1:], inertia)

    def gravity_torque(self, q, load=None, gravity=(0.0, 0.0, -9.80665)):
        return torque_of(self.model(load, gravity), np.atleast_2d(q))


@pytest.fixture(scope="session")
def arm():
    return Arm()


@pytest.fixture(scope="session")
def poses():
    """Twelve postures well spread over the joint space."""
    return np.random.default_rng(11).uniform([-2, -1.2, -1.5, -2.5, -1.8, -2.5], [2, 1.2, 1.5, 2.5, 1.8, 2.5], (12, 6))


@pytest.fixture(scope="session")
def table_of():
    return make_table


def value_of(load):
    """Mass and centre of gravity of a load, and their standard deviations."""
    return np.array([load.mass_kg, *load.com_m]), np.array([load.mass_std_kg, *load.com_std_m])


def make_measured(
    arm, poses, loads, rng=None, left=0.0, sides=(1, -1), bias=0.0, gravity=(0.0, 0.0, -9.80665), efficiency=1.0
):
    """Two-sided rest table: pinocchio's gravity, a friction band, `left` of it scattered, `bias` of it common.

    loads: label -> (mass, x, y, z) or None for the unloaded arm
    """
    rows = {"load": [], "pose": [], "q": [], "tau": [], "direction": []}
    band_nm = arm.band_nm
    for label, load in loads.items():
        torque = arm.gravity_torque(poses, load, gravity)
        for number, (q, tau) in enumerate(zip(poses, torque, strict=True)):
            for side in sides:
                scatter = 0.0 if rng is None else left * band_nm * rng.standard_normal(len(band_nm)) * np.sqrt(2)
                rows["load"].append(label)
                rows["pose"].append(number)
                rows["q"].append(q)
                behind = tau + side * band_nm + bias * band_nm + scatter
                rows["tau"].append(np.where(behind * side > 0, behind / efficiency, behind * efficiency))
                rows["direction"].append(np.full(len(band_nm), side))
    return make_table(rows["load"], rows["pose"], rows["q"], rows["tau"], direction=np.array(rows["direction"]))


@pytest.fixture(scope="session")
def measured():
    return make_measured


@pytest.fixture(scope="session")
def band_nm():
    return BAND_NM
