"""The drawing of the links is trusted as far as the rows themselves allow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from gateway.diagnose import diagnose
from gateway.diagnose.moving.choice import log_evidence
from gateway.diagnose.moving.moving_rows import blocks
from gateway.diagnose.moving.null_model import MovingNoise, null_model
from gateway.diagnose.moving.penalised_fit import MovingProblem
from gateway.identify.knowledge import Knowledge
from gateway.model.motion import prepare
from tests.data.moving_arm import GRAVITY, World, measured


def trust_of(result) -> float:
    said = str(result.provenance["inertials"])
    return float("inf") if said == "ignore" else float(said.removeprefix("prior:"))


@pytest.mark.slow
@pytest.mark.parametrize(("cad_error", "least", "most"), [(0.0, 0.0, 0.02), (0.25, 0.1, float("inf"))])
def test_a_good_drawing_is_trusted_and_a_bad_one_is_not(cad_error, least, most):
    table, robot, _ = measured(3, World(), duration_s=20.0, cad_error=cad_error)
    assert least <= trust_of(diagnose(table, robot)) <= most


@pytest.mark.slow
def test_the_users_statement_on_the_drawing_is_kept():
    table, robot, _ = measured(3, World(), duration_s=20.0, cad_error=0.25)
    for trust in (0.03, np.inf):
        assert trust_of(diagnose(table, robot, Knowledge(link_std=trust), only=frozenset({"base_tilt"}))) == trust
    heavy = replace(robot, mass_kg=3.0 * robot.mass_kg, inertia_kg_m2=3.0 * robot.inertia_kg_m2)
    found = diagnose(table, heavy, Knowledge(link_std=0.03), only=frozenset({"base_tilt"}))
    assert (found.verdict, found.effects, found.findings[0].check) == ("unexplained", (), "torque_constants")


def test_evidence_is_the_marginal_density_of_the_rows():
    """Against scipy's density of the rows with the parameters integrated out, trust against trust."""
    table, robot, _ = measured(5, World(), duration_s=3.0, rate_hz=10.0)
    motion = prepare(table, None, robot, GRAVITY)
    noise = MovingNoise(np.full(6, 3.0), np.full(6, 0.5))
    values, expected = [], []
    for trust in (0.05, 0.2):
        null = null_model(motion, trust, Knowledge())
        # friction that is free is beyond what a dense density resolves: here it has a size
        prior = null.columns.prior
        prior = prior.with_std(null.friction.ravel(), np.full(24, 100.0))
        null = replace(null, columns=replace(null.columns, prior=prior)).held(null.usual, 0.0)
        problem = MovingProblem(motion, null, noise, blocks(motion, 3))
        values.append(log_evidence(problem, ()))
        judged, prior = motion.judged.ravel(), null.columns.prior
        columns = (null.columns.design * noise.weight[:, None]).reshape(len(judged), -1)[judged]
        covariance = np.linalg.inv(prior.precision)
        target = (motion.tau_nm * noise.weight).ravel()[judged] - columns @ covariance @ prior.pull
        spread = np.eye(len(target)) + columns @ covariance @ columns.T
        expected.append(stats.multivariate_normal.logpdf(target, np.zeros(len(target)), spread))
    assert values[1] - values[0] == pytest.approx(expected[1] - expected[0], rel=1e-4)
