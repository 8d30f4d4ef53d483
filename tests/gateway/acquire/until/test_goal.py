"""--until as it is typed: units, and what is refused in a sentence."""

import math

import numpy as np
import pytest

from gateway.acquire.until_goal import Goal, half_widths, parse_until
from gateway.errors import InputError
from gateway.identify.load_estimate import unknown_load


@pytest.mark.parametrize(
    ("text", "goal"),
    [
        ("mass=0.5%,com=3mm", Goal(mass_share=0.005, com_m=0.003)),
        (" com = 0.002 m , mass=0.2kg", Goal(mass_kg=0.2, com_m=0.002)),
        ("mass=20g", Goal(mass_kg=0.02)),
        ("com=3mm", Goal(com_m=0.003)),
    ],
)
def test_what_is_typed_is_meant(text, goal):
    parsed = parse_until(text)
    for name in ("mass_kg", "mass_share", "com_m"):
        assert getattr(parsed, name) == pytest.approx(getattr(goal, name))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "must be mass=.. or com=.."),
        ("weight=1kg", "'weight=1kg' must be"),
        ("mass=0.5", "lacks its unit (kg, g, %)"),
        ("com=3%", "not a number with a unit (m, mm)"),
        ("mass=-1kg", "a half width must be positive"),
        ("mass=nan%", "a half width must be positive"),
        ("mass=1kg,mass=2%", "mass is given twice"),
        ("com=3m", "is too large to be a goal"),
        ("mass=80%", "is too large to be a goal"),
    ],
)
def test_what_cannot_be_meant_is_refused_by_name(text, says):
    with pytest.raises(InputError) as refused:
        parse_until(text)
    assert says in str(refused.value)
    assert "such as mass=0.5%,com=3mm" in str(refused.value)


def test_a_share_is_of_the_mass_and_what_is_not_asked_for_never_holds_up():
    assert Goal(mass_share=0.01, com_m=0.003).half_widths(-50.0).tolist() == [0.5, 0.003, 0.003, 0.003]
    assert Goal(com_m=0.003).half_widths(50.0)[0] == math.inf


def test_what_is_not_known_of_a_load_is_infinitely_wide():
    assert np.isinf(half_widths(None)).all()
    assert np.isinf(half_widths(unknown_load("a"))).all()
