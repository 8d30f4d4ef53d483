"""A simulated measuring device, from its own side; on the wire it is judged by the tests of the master."""

from __future__ import annotations

from sim.measuring import FakeMeasuringDevice, MeasuringSite


def test_a_measuring_device_says_that_it_is_simulated() -> None:
    site = MeasuringSite(21, 0x9130, "i32", None, (1, 2), 1e-6, (0.0, 0.02))
    device = FakeMeasuringDevice(site, lambda: [1e-3, 2e-3], lambda _message: None)
    assert device.node.get_data(0x5FFE, 0) == b"servo-sim"
