"""The shape of a family: what the rows want, held by what was plausible beforehand."""

from __future__ import annotations

from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest

from gateway.diagnose.moving import refine
from gateway.model.effects.balancer_spring import CoilBalancer


@pytest.mark.parametrize("weight", [0.0, 3.0, 1e6])
def test_a_shape_is_between_its_prior_and_what_the_rows_say(monkeypatch, weight):
    """Rows with the weight w about 0.8 rad and a prior of 0.4 rad about 0: w s^2 / (1 + w s^2) of the distance."""
    term, wanted = CoilBalancer(phase_rad=0.0), np.array([0.8, 0.2])
    trial = SimpleNamespace(term=term, value=None, covariance=None, p_demand=0.0, gain=1.0)
    rows = MagicMock(**{"motion.axes": 6})

    def extend(_fit, _axes, shape, _prior):
        return None, None, None, -weight * float((shape - wanted) @ (shape - wanted))

    monkeypatch.setattr(CoilBalancer, "columns", lambda tried, *_: np.array(tried.start[2:]))
    monkeypatch.setattr(refine, "extend", extend)
    for name, found in (("trials_of", [trial]), ("put_on_trial", trial), ("possible", True)):
        monkeypatch.setattr(refine, name, MagicMock(return_value=found))
    found = refine.refine(rows, rows, term, [term])
    start, spread = np.array(term.start[2:]), np.array(term.spread[2:])
    share = weight * spread**2 / (1.0 + weight * spread**2)
    assert np.array(found.start[2:]) == pytest.approx(start + share * (wanted - start), abs=2e-3)
    assert found.largest_nm == term.largest_nm
