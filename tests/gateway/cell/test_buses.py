"""Which bus each arm is on: the cell's, or what `--bus` says."""

from __future__ import annotations

from pathlib import Path

import pytest

from drives.bus import BusSpec
from drives.errors import BusError
from gateway.cell.buses import bus_specs
from gateway.cell.config import load_cell
from gateway.errors import ConfigError

EXAMPLES = Path(__file__).parents[3] / "examples"
ONE = load_cell(EXAMPLES / "small" / "cell.toml").cell
TWO = load_cell(EXAMPLES / "pair" / "cell.toml").cell


def own(cell, name):
    config = cell.bus[name]
    return BusSpec(config.interface, config.channel, config.bitrate_bit_s, config.options)


def test_without_a_word_every_bus_is_the_cells():
    assert bus_specs(TWO, None) == {name: own(TWO, name) for name in ("left", "right")}


@pytest.mark.parametrize("text", ["socketcan:can1", "udp_multicast:239.74.163.2,port=43199", "virtual:a,receive=true"])
def test_one_spec_for_a_cell_with_one_bus(text):
    (name,) = ONE.bus
    assert bus_specs(ONE, text) == {name: BusSpec.parse(text)}
    assert bus_specs(ONE, f"{name}={text}") == {name: BusSpec.parse(text)}


@pytest.mark.parametrize(
    "text", ["left=socketcan:can1;right=socketcan:can1", f"right={own(TWO, 'left')}", f"right={own(TWO, 'left')},fd=0"]
)
def test_one_bus_under_two_names_is_refused(text):
    with pytest.raises(ConfigError, match="one bus has one master"):
        bus_specs(TWO, text)


def test_every_bus_by_its_name():
    found = bus_specs(TWO, "right=socketcan:can1; left=udp_multicast:239.74.163.2,port=5")
    assert found == {
        "left": BusSpec("udp_multicast", "239.74.163.2", options={"port": 5}),
        "right": BusSpec("socketcan", "can1"),
    }
    assert bus_specs(TWO, "right=socketcan:can1")["left"] == own(TWO, "left")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("socketcan:can0", "the cell has 2 buses, and no bus is named"),
        ("udp_multicast:239.74.163.2,port=43113", "give NAME=SPEC;NAME=SPEC with left, right"),
        ("left=virtual:a;virtual:b", "no bus is named"),
        ("middle=virtual:a", "no bus 'middle'"),
        ("left=virtual:a;left=virtual:b", "given twice"),
        ("left=virtual:a;", "no bus is named"),
    ],
)
def test_what_does_not_say_which_bus_is_refused_in_words(text, says):
    with pytest.raises(ConfigError, match=says):
        bus_specs(TWO, text)


@pytest.mark.parametrize("text", ["left=", "left=virtual", "left=virtual:a,b"])
def test_a_spec_that_is_none_is_refused(text):
    with pytest.raises(BusError):
        bus_specs(TWO, text)
