"""Conditions for naming an effect: each of them alone decides."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from gateway.diagnose.moving.moving_diagnosis_thresholds import MOVING
from gateway.diagnose.moving.select import demands, is_significant, penalty
from gateway.model.effects.axis_coupling import MotorCoupling, TorqueMixing
from gateway.model.effects.balancer_spring import HarmonicBalancer
from gateway.model.effects.base_tilt import BaseTilt
from gateway.model.effects.load_dependent_friction import LoadDependentFriction
from gateway.model.effects.torque_offset import TorqueOffset
from gateway.model.effects.torque_ripple import TorqueRipple

PROBLEM = SimpleNamespace(motion=SimpleNamespace(axes=6))
TRIED = 200


@dataclass(frozen=True)
class Shown:
    """A trial that just meets every demand on an effect that any gear has."""

    term: object
    ratio: float = MOVING.ordinary.ratio
    gain: float = 1e-9
    p_demand: float = MOVING.ordinary.p_demand / TRIED
    p_held: float = MOVING.ordinary.p_held
    blocks_better: float = MOVING.ordinary.blocks_better


@pytest.mark.parametrize(
    "worse",
    [
        {"ratio": MOVING.ordinary.ratio + 1e-9},
        {"gain": 0.0},
        {"p_demand": 1.01 * MOVING.ordinary.p_demand / TRIED},
        {"p_held": MOVING.ordinary.p_held + 1e-9},
        {"blocks_better": MOVING.ordinary.blocks_better - 1e-9},
    ],
    ids=lambda value: next(iter(value)),
)
def test_each_demand_alone_decides(worse):
    shown = Shown(LoadDependentFriction(1))
    assert is_significant(PROBLEM, shown, TRIED)
    assert not is_significant(PROBLEM, replace(shown, **worse), TRIED)


def test_a_fault_or_an_extra_part_needs_more_than_what_any_gear_has():
    assert demands(LoadDependentFriction(1), 6) is demands(MotorCoupling(4, 5, 1.0), 6) is MOVING.ordinary
    assert demands(TorqueMixing(4, 5), 6) is demands(TorqueOffset(1), 6) is MOVING.special
    assert demands(BaseTilt(), 6) is MOVING.special_all_axes
    assert demands(BaseTilt(), 2) is MOVING.special, "two axes are not many"
    assert not is_significant(PROBLEM, Shown(TorqueOffset(1)), TRIED)


def test_what_is_rare_and_has_many_shapes_has_more_to_make_good():
    assert penalty(LoadDependentFriction(1)) == 1.0
    assert penalty(TorqueOffset(1)) == pytest.approx(1.0 + np.log(MOVING.rare))
    assert penalty(HarmonicBalancer()) == pytest.approx(4.0 + np.log(MOVING.rare))


def test_an_order_that_was_looked_for_pays_for_every_order_that_was_tried():
    least = 0.99 * MOVING.special.p_demand / TRIED / 700
    shown = Shown(TorqueRipple(1, 80.0, 700), 0.5, p_demand=least, p_held=0.0, blocks_better=1.0)
    assert is_significant(PROBLEM, shown, TRIED)
    assert not is_significant(PROBLEM, replace(shown, p_demand=2.0 * least), TRIED)
    assert is_significant(PROBLEM, replace(shown, term=TorqueRipple(1, 80.0), p_demand=700 * least), TRIED)
