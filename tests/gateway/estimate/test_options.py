"""Options as a person types them."""

import math

import pytest

from gateway.errors import ConfigError, InputError
from gateway.estimate.options import EstimateOptions, parse_known
from gateway.identify.links import default_inertials, parse_inertials


def test_inertials():
    assert parse_inertials("exact") == 0.0
    assert parse_inertials("ignore") == math.inf
    assert parse_inertials("prior:0.05") == 0.05
    assert EstimateOptions(inertials="prior:0.2").trust == 0.2


@pytest.mark.parametrize("text", ["", "prior", "prior:", "prior:0", "prior:-1", "prior:nan", "0.05", "prior:x"])
def test_inertials_that_mean_nothing(text):
    with pytest.raises(ConfigError, match="prior:0.05"):
        parse_inertials(text)


def test_known():
    assert parse_known("tool=12.5,0,-0.1,0.11") == ("tool", (12.5, 0.0, -0.1, 0.11))
    assert parse_known(" tool =1,0,0,0")[0] == "tool"


@pytest.mark.parametrize(
    "text", ["", "tool", "tool=1,2,3", "tool=1,2,3,x", "=1,0,0,0", "tool=-1,0,0,0", "tool=inf,0,0,0"]
)
def test_known_that_means_nothing(text):
    with pytest.raises(InputError, match="LABEL=MASS,X,Y,Z"):
        parse_known(text)


def test_default_inertials(arm):
    assert default_inertials(arm.robot) == "prior:0.05"
