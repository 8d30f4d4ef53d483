"""Conditions for naming an effect: each of them alone decides."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from gateway.diagnose.moving.moving_diagnosis_thresholds import MOVING
from gateway.diagnose.moving.select import is_significant, penalty
from gateway.model.effects import DRAWN
from gateway.model.effects.axis_coupling import MotorCoupling, TorqueMixing
from gateway.model.effects.balancer_spring import HarmonicBalancer
from gateway.model.effects.base_tilt import BaseTilt
from gateway.model.effects.load_dependent_friction import LoadDependentFriction
from gateway.model.effects.torque_offset import TorqueOffset
from gateway.model.effects.torque_ripple import TorqueRipple

TRIED = 200


@dataclass(frozen=True)
class Shown:
    """A trial that just meets every demand on an effect that any gear has."""

    term: object
    ratio: float = MOVING.common_ratio
    sure: float = MOVING.sure
    p_demand: float = MOVING.demanded / TRIED


@pytest.mark.parametrize(
    "worse",
    [
        {"ratio": MOVING.common_ratio + 1e-9},
        {"sure": MOVING.sure - 1e-9},
        {"p_demand": 1.01 * MOVING.demanded / TRIED},
    ],
    ids=lambda value: next(iter(value)),
)
def test_each_demand_alone_decides(worse):
    shown = Shown(LoadDependentFriction(1))
    assert is_significant(shown, TRIED)
    assert not is_significant(replace(shown, **worse), TRIED)


def test_a_fault_or_an_extra_part_may_be_small_where_held_out_rows_prove_it():
    for fault in (TorqueMixing(4, 5), TorqueOffset(1), BaseTilt()):
        assert is_significant(Shown(fault, ratio=0.97), TRIED)
        assert not is_significant(Shown(fault, ratio=0.97, sure=0.99 * MOVING.sure), TRIED)
        visible = Shown(fault, ratio=MOVING.visible_ratio, sure=MOVING.sure_if_visible)
        assert is_significant(visible, TRIED) == (fault.name not in DRAWN), "links can imitate a tilt and an offset"
    assert not is_significant(Shown(MotorCoupling(4, 5, 1.0), ratio=0.97), TRIED), "any wrist has it"


def test_what_is_rare_and_has_many_shapes_has_more_to_make_good():
    assert penalty(LoadDependentFriction(1)) == 1.0
    assert penalty(TorqueOffset(1)) == pytest.approx(1.0 + np.log(MOVING.rare))
    assert penalty(HarmonicBalancer()) == pytest.approx(4.0 + np.log(MOVING.rare))


def test_an_order_that_was_looked_for_pays_for_every_order_that_was_tried():
    least = 0.99 * MOVING.demanded / TRIED / 700
    shown = Shown(TorqueRipple(1, 80.0, 700), 0.5, p_demand=least)
    assert is_significant(shown, TRIED)
    assert not is_significant(replace(shown, p_demand=2.0 * least), TRIED)
    assert is_significant(replace(shown, term=TorqueRipple(1, 80.0), p_demand=700 * least), TRIED)
