"""How cells of nature are counted; every mechanism has its right names."""

from __future__ import annotations

import pytest

from benchmarks.blind.mechanisms import MECHANISMS
from benchmarks.blind.nature_figures import effect_figures
from benchmarks.nature.nature_cell import NAMED
from benchmarks.nature.unmodelled import UNMODELLED
from benchmarks.nature.wiring import WIRING
from gateway.model.effects import LIBRARY


def cell(kind: str = "nuisance", truth: tuple = (), found: tuple = (), verdict: str = "none_needed", **more) -> dict:
    inside = {"inside": [1.0, 1.0, 1.0, 0.0], "width": [1.0, 1.1, 1.2, 1.3]}
    return {
        "seed": 0,
        "condition": "base",
        "kind": kind,
        "misstated": False,
        "truth": list(truth),
        "beside": [size for _, _, size in truth],
        "visits": [(0, "none"), (0, "tool"), (1, "none"), (1, "tool")],
        "outliers": [],
        "estimated": inside,
        "diagnosed": inside,
        "found": list(found),
        "verdict": verdict,
        "set_aside": [],
        "formula": [],
        "formula_left": float("nan"),
        "log_ratios": [50.0] * len(truth),
        "refused": [],
        "total_s": 1.0,
    } | more


def test_every_mechanism_has_its_names_and_every_name_is_one_of_the_library():
    assert set(MECHANISMS) == set(NAMED) | set(UNMODELLED) | set(WIRING)
    mistakes = {"sign_reversed", "axes_swapped", "current_rms_peak"}
    assert {name for names in MECHANISMS.values() for name in names} <= set(LIBRARY) | mistakes
    assert all(MECHANISMS[name] for name in NAMED | WIRING)
    assert not any(MECHANISMS[name] for name in UNMODELLED)


def test_one_several_and_strange_ones_are_counted_apart():
    offset = ("offset_sensor", [3], 5.0)
    cells = [
        cell("one", [offset], [("static_friction", [3])], "explained"),
        cell("one", [("tilted_base", [], 2.0)], [("joint_zero_offset", [2])], "improved"),
        cell("several", [offset, ("tilted_base", [], 4.0)], [("base_tilt", [])], "explained"),
        cell("strange", [("tether", [], 9.0)], [("cable_torque", [5])], "improved"),
        cell("strange", [("tether", [], 9.0)], [], "unexplained"),
        cell("wiring", [("turned_sign", [2], float("inf"))], [("sign_reversed", [2])], "explained"),
    ]
    out = effect_figures(cells)
    assert out["right, one effect of strength >= 3"]["value"] == 1.0
    assert out["right, one effect of strength 1.5 to 3"]["value"] == 0.0
    assert out["right, two or more effects, each of strength >= 3"]["value"] == 0.0
    assert out["off-library given a library name"]["value"] == 0.5
    assert out["wiring mistakes named"]["value"] == 1.0
    assert out["something named that is not there"]["value"] == pytest.approx(1 / 3)
    assert out["wrong, one effect with sufficient data"]["value"] == 0.5
    cells[1]["log_ratios"] = [5.0]
    assert effect_figures(cells)["wrong, one effect with sufficient data"]["value"] == 0.0
