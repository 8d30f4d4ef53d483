"""Options as a person types them."""

import math

import pytest

from gateway.errors import ConfigError
from gateway.estimate.options import EstimateOptions
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


def test_default_inertials(arm):
    assert default_inertials(arm.robot) == "prior:0.05"
