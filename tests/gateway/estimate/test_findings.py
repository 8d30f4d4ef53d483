"""What is said of a load and of the rows: by numbers on either side of each limit."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from gateway.estimate import difference, posture, recommendation
from gateway.estimate.consistency import physical_findings
from gateway.estimate.describe import axis_sigma
from gateway.model.base import rest_base


def load(mass_kg: float, std_kg: float = 0.1, com_m=(0.0, 0.0, 0.1), com_std_m=(0.01, 0.01, 0.01)):
    return SimpleNamespace(
        label="tool",
        mass_kg=mass_kg,
        mass_std_kg=std_kg,
        com_m=np.array(com_m),
        com_std_m=np.array(com_std_m),
        inertia=None,
    )


@pytest.mark.parametrize(
    ("com_x_m", "std_m", "says"),
    [
        (0.99, 0.0, ""),
        (1.02, 0.0, "outside a sphere"),
        (1.02, 0.1, "within its uncertainty"),
        (1.02, np.nan, "outside"),
    ],
)
def test_a_centre_of_mass_outside_the_sphere_is_doubted(com_x_m, std_m, says):
    found = physical_findings(load(9.0, com_m=(com_x_m, 0.0, 0.0), com_std_m=(std_m, 0.0, 0.0)), "link_6", 1.0)
    assert [says in finding.what for finding in found] == ([True] if says else [])
    assert ["may be inside" in finding.what for finding in found] == ([std_m == 0.1] if says else [])


def test_the_noise_of_an_axis_is_that_of_its_own_rows():
    use = np.zeros((3, 6), dtype=bool)
    use[:, [0, 2, 5]] = [[True, True, True], [True, True, False], [True, False, False]]
    std = np.array([2.0, 9.0, 4.0, 9.0, 9.0, 0.5, *[7.0] * 6, *[1.0] * 6])
    group = np.concatenate([np.broadcast_to(np.arange(6), (3, 6))[use], [6, 6]])
    group[0] = 12  # one of the three visits of J1 came from one side
    problem = SimpleNamespace(use_sum=use, group=group, axis=group % 6, axes=6)
    found = axis_sigma(problem, SimpleNamespace(noise=SimpleNamespace(std=std)))  # type: ignore[arg-type]
    assert found == pytest.approx([2.0, np.nan, 4.0, np.nan, np.nan, 0.5], nan_ok=True)


def test_what_lumps_with_the_load_is_named_and_nothing_else(arm):
    base = rest_base(arm.robot)
    said = posture._limits(base, 6).what
    listed = said[said.index("(") + 1 : said.rindex(");")].split("; ")
    assert listed == [name for name in base.names if "_6" in name]
    assert 0 < len(listed) < len(base.names)


def test_moments_that_a_load_leaves_open_are_bounded_by_an_unknown_load():
    """Mass up to an unknown load, moments up to that 0.3 m away; what is known stays as it is."""
    known = SimpleNamespace(refused=None, covariance=np.diag([1.0, 2.0, 3.0, 4.0]), unidentifiable=())
    assert recommendation._with_unknown(known, 1.0) == pytest.approx(known.covariance, abs=1e-9)  # type: ignore[arg-type]
    half = SimpleNamespace(refused=None, covariance=known.covariance, unidentifiable=("com_y_m",))
    wide = (0.3 * recommendation._UNKNOWN_KG) ** 2
    assert np.diag(recommendation._with_unknown(half, 1.0)) == pytest.approx([1.0, 2.0, 3.0 + wide, 4.0])  # type: ignore[arg-type]
    mass = SimpleNamespace(refused=None, covariance=known.covariance, unidentifiable=("mass_kg",))
    assert recommendation._with_unknown(mass, 1.0)[0, 0] == pytest.approx(1.0 + recommendation._UNKNOWN_KG**2)  # type: ignore[arg-type, index]
    assert recommendation._with_unknown(mass, 0.25)[0, 0] == pytest.approx(0.25 + recommendation._UNKNOWN_KG**2)  # type: ignore[arg-type, index]
    refused = SimpleNamespace(refused="too few", covariance=known.covariance, unidentifiable=())
    assert recommendation._with_unknown(refused, 1.0) is None  # type: ignore[arg-type]


@pytest.mark.parametrize(("times", "said"), [(0.9, False), (1.1, True)])
def test_rows_contradict_each_other_where_they_leave_more_than_friction_does(monkeypatch, times, said):
    """Residuals in units of what the half differences scatter by, of the axes whose scatter is known."""
    sigma = np.array([1.0, 2.0, 4.0, 0.5, 1.0, 1.0])
    freedom = np.array([9, 9, 9, 9, 2, 9])
    monkeypatch.setattr(difference, "half_difference_scatter", lambda *_: (sigma**2 / 2.0, freedom))
    monkeypatch.setattr(difference, "disagree", lambda _masses: True)
    axis = np.tile(np.arange(6), 20)
    residual = times * difference.CONTRADICTS * sigma[axis] * np.where(axis == 4, 1e6, 1.0)
    visits = SimpleNamespace(difference_nm=None, sum_nm=None)
    contradiction = difference._contradiction(
        visits,
        SimpleNamespace(axis=axis),
        SimpleNamespace(residual=residual),
        {"a": 3.0, "b": 9.0},  # type: ignore[arg-type]
    )
    assert (contradiction is not None) == said
    for words in (f"{times * difference.CONTRADICTS:.0f} times what the friction leaves", "3 to 9 kg (median 6)"):
        assert (words in (contradiction or "")) == said
