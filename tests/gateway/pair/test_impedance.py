"""Implicit impedance against its differential equation, and the rule of stability against a simulated loop."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from gateway.errors import ConfigError
from gateway.pair.impedance import Admittance, Gains, lag_of_correction_s, refuse_unstable, stability_margin

CHAIN = np.diag(np.repeat([1.6e5, 3.6e3], 3))


def test_pure_integral_action() -> None:
    admittance = Admittance(Gains((5000.0, 100.0)), 0.004)
    for _ in range(100):
        x = admittance.step(np.array([10.0, 0, 0, 0, 0, 1.0]))
    assert x[0] == pytest.approx(10.0 * 0.4 / 5000.0)
    assert x[5] == pytest.approx(0.4 / 100.0)


def test_printed_recursion_without_mass() -> None:
    admittance, x, dt, d, k = Admittance(Gains((5000.0, 100.0), (2e4, 300.0)), 0.004), 0.0, 0.004, 5000.0, 2e4
    for force in np.sin(np.arange(50.0)):
        x = (d * x + dt * force) / (d + dt * k)
        assert admittance.step(np.array([force, 0, 0, 0, 0, 0]))[0] == pytest.approx(x, rel=1e-12)


def test_mass_spring_damper_follows_its_equation() -> None:
    m, d, k, dt = 50.0, 2000.0, 3e4, 1e-4
    admittance = Admittance(Gains((d, 1.0), (k, 0.0), (m, 0.0)), dt)
    steps = [admittance.step(np.array([20.0, 0, 0, 0, 0, 0]))[0] for _ in range(5000)]
    times = dt * np.arange(1, 5001)
    exact = solve_ivp(
        lambda t, y: [y[1], (20.0 - d * y[1] - k * y[0]) / m], (0, 0.5), [0.0, 0.0], t_eval=times, rtol=1e-9, atol=1e-12
    )
    assert np.allclose(steps, exact.y[0], atol=5e-3 * 20.0 / k)


def test_implicit_form_is_stable_for_any_cycle_time() -> None:
    admittance = Admittance(Gains((1.0, 1.0), (1e6, 1e6), (1.0, 1.0)), 0.1)
    for _ in range(200):
        x = admittance.step(np.ones(6))
    assert np.allclose(x, 1e-6, rtol=1e-3)


def simulated_boundary(stiffness: float, delay_cycles: int, dt_s: float) -> float:
    """Smallest damping at which x' = -K x(t - T)/D still dies out."""
    for damping in np.geomspace(500.0, 20000.0, 200):
        history = np.zeros(4000)
        history[: delay_cycles + 1] = 1e-3
        for n in range(delay_cycles, len(history) - 1):
            history[n + 1] = history[n] - dt_s * stiffness * history[n - delay_cycles] / damping
        if np.abs(history[-500:]).max() < 1e-3:
            return float(damping)
    return np.inf


def test_rule_of_stability_matches_a_delayed_loop() -> None:
    dt_s, cycles = 0.001, 35
    boundary = simulated_boundary(1.6e5, cycles, dt_s)
    assert boundary == pytest.approx(2.0 / np.pi * 1.6e5 * 0.035, rel=0.05)
    assert stability_margin(Gains((boundary, 1e9)), CHAIN, 0.035) == pytest.approx(1.0, rel=0.05)


def test_unstable_gains_are_refused_with_what_to_use() -> None:
    assert refuse_unstable(Gains((7200.0, 162.0)), CHAIN, 0.035) == pytest.approx(2.02, rel=0.01)
    with pytest.raises(ConfigError, match=r"times the limit of oscillation.*use about 7\.1"):
        refuse_unstable(Gains((3000.0, 162.0)), CHAIN, 0.035)
    with pytest.raises(ConfigError, match="limit of oscillation"):
        refuse_unstable(Gains((7200.0, 50.0)), CHAIN, 0.035)
    with pytest.raises(ConfigError, match="limit of oscillation"):
        refuse_unstable(Gains((4000.0, 100.0), inertia=(400.0, 0.0)), CHAIN, 0.035)


def test_coupled_stiffness_counts_by_its_largest_direction() -> None:
    coupled = CHAIN.copy()
    coupled[0, 4] = coupled[4, 0] = 1.5e4
    assert stability_margin(Gains((7200.0, 162.0)), coupled, 0.035) < stability_margin(
        Gains((7200.0, 162.0)), CHAIN, 0.035
    )


def test_yielding_master_sweeps_the_far_end_of_the_part() -> None:
    """A turn of the master moves fingertip 2 by the lever: 0.4 m make 1.6e5 N/m to 2.6e4 Nm/rad on top of 3.6e3."""
    lever, gains = np.array([0.4, 0.0, 0.0]), Gains((1e9, 1000.0))
    expected = (np.pi / 2.0) / ((3.6e3 + 0.16 * 1.6e5) / 1000.0 * 0.035)
    assert stability_margin(gains, CHAIN, 0.035, [lever]) == pytest.approx(expected, rel=1e-4)
    alone = stability_margin(Gains((7200.0, 162.0)), CHAIN, 0.035)
    both = stability_margin(Gains((7200.0, 162.0)).doubled(), CHAIN, 0.035, [np.zeros(3), np.zeros(3)])
    assert both == pytest.approx(alone)


def test_lag_of_the_correction() -> None:
    assert lag_of_correction_s(Gains((6400.0, 1.0)), CHAIN, 0.035) == pytest.approx(0.04 + 0.035)


@pytest.mark.parametrize("pair", [(0.0, 1.0), (-1.0, 1.0), (np.nan, 1.0)])
def test_useless_damping_is_refused(pair: tuple[float, float]) -> None:
    with pytest.raises(ConfigError, match="damping"):
        Gains(pair)
