"""What is said of a load and of the rows: by numbers on either side of each limit."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from gateway.estimate import estimate
from gateway.estimate.estimate import axis_sigma, physical_findings
from gateway.identify.knowledge import Knowledge
from gateway.model.base import rest_base

TOOL = (8.0, 0.12, -0.03, 0.05)


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


def test_what_lumps_with_the_load_is_named_and_nothing_else(arm, poses, measured):
    base = rest_base(arm.robot)
    table = measured(arm, poses, {"tool": TOOL})
    said = estimate(table, arm.robot, Knowledge(link_std=0.0), "posture").findings[0].what
    listed = said[said.index("(") + 1 : said.rindex(");")].split("; ")
    assert listed == [name for name in base.names if "_6" in name]
    assert 0 < len(listed) < len(base.names)
