"""Strict scoring: exactly what is there, and nothing else."""

from __future__ import annotations

import pytest

from benchmarks.blind.strict import Said, misnamed, right, there

TILT = there(("base_tilt",), (), 8.0)
OFFSET = there(("torque_offset", "static_friction"), (3,), 5.0)
FAINT = there(("cable_torque",), (5,), 1.2)
CABLE, ZERO = ("cable_torque", (5,)), ("joint_zero_offset", (2,))
TILTED, BIASED = ("base_tilt", ()), ("static_friction", (3,))


@pytest.mark.parametrize(
    ("truth", "found", "verdict", "is_right", "is_misnamed"),
    [
        ((TILT,), (TILTED,), "explained", True, False),
        ((TILT,), (TILTED,), "improved", True, False),
        ((TILT,), (ZERO,), "improved", False, True),
        ((TILT,), (TILTED, ZERO), "explained", False, True),
        ((TILT,), (), "none_needed", False, False),
        ((TILT,), (), "unexplained", False, False),
        ((TILT,), (TILTED, ZERO), "undecided", True, False),
        ((TILT,), (TILTED, ZERO, CABLE), "undecided", False, True),
        ((TILT,), (ZERO,), "undecided", False, True),
        ((TILT,), (), "undecided", False, False),
        ((OFFSET,), (BIASED,), "explained", True, False),
        ((OFFSET,), (("torque_offset", (3,)), BIASED), "explained", False, False),
        ((OFFSET,), (("static_friction", (4,)),), "explained", False, True),
        ((TILT, OFFSET), (TILTED, BIASED), "explained", True, False),
        ((TILT, OFFSET), (TILTED,), "explained", False, False),
        ((TILT, OFFSET), (TILTED, BIASED), "undecided", False, False),
        ((TILT, FAINT), (TILTED,), "explained", True, False),
        ((TILT, FAINT), (TILTED, CABLE), "explained", True, False),
        ((FAINT,), (CABLE,), "explained", True, False),
        ((FAINT,), (), "none_needed", True, False),
        ((FAINT,), (ZERO,), "explained", False, True),
        ((there((), (2,), 9.0),), (ZERO,), "undecided", False, True),
        ((), (ZERO,), "improved", False, True),
    ],
)
def test_answers(truth, found, verdict, is_right, is_misnamed):
    assert right(truth, Said(found, verdict)) is is_right
    assert misnamed(truth, Said(found, verdict)) is is_misnamed
