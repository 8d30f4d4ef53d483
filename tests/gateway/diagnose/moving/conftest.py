"""The small arm, and moving rows of random torques: the numbers mean nothing, the algebra does."""

import numpy as np
import pytest

from gateway.data.rows import MOVING
from gateway.model.robot import robot_from_urdf
from tests.data.arms import sines
from tests.data.moving_arm import URDF
from tests.support.rigs.tables import make_table


@pytest.fixture(scope="module")
def robot():
    return robot_from_urdf(URDF, "robot.urdf")


def random_rows(seed=0, n=400, run="1", load="none", size_nm=1.0):
    """Sums of two sines an axis at 20 Hz, with random torques of this size."""
    generator = np.random.default_rng(seed)
    time = np.arange(n) / 20.0
    q, qd, qdd = sines(time, 1.0, generator.uniform(0.5, 2.0, (2, 6)), generator.uniform(0, 6, (2, 6)))
    tau = generator.normal(size=(n, 6)) * size_nm
    return make_table([load] * n, np.full(n, MOVING), q, tau, run=[run] * n, time=time, qd=qd, qdd=qdd)
