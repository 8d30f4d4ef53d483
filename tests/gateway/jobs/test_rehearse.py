"""Rehearsal of a plan: what is counted, what is refused before an arm is drawn, one small one from end to end."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from gateway.cli import main
from gateway.errors import ConfigError, InputError
from gateway.jobs.rehearse import detection, rehearse, summary
from gateway.result.origin import sealed

SMALL = Path(__file__).parents[3] / "examples" / "small"


def run(effect: str | None, joints: list[int], **stated: Any) -> dict[str, Any]:
    """An arm of a rehearsal as `rehearse` keeps it."""
    error = {"mass_kg": 100.0, "error": [1.0, 0.001, 0.001, 0.001], "std": [1.0, 0.001, 0.001, 0.001]}
    usual = {"verdict": "explained", "found": [], "next": None, "estimate": error, "calibrated": None}
    sized = {"strength": 2.0, "parameter": "offset_rad", "size": 0.02, "largest_share": 0.1}
    known = usual | (sized if effect else {"strength": None}) | {"effect": effect, "joints": joints} | stated
    listed = [effect, joints] in known["found"]
    return {"listed": listed, "named": listed and known["verdict"] != "undecided", "seed": 0} | known


def test_detection_strength_is_that_of_the_logistic_that_drew_the_names() -> None:
    rng, middle, slope = np.random.default_rng(3), np.log([1.0, 3.0, 8.0]), 3.0
    place = np.repeat([0, 1, 2], 400)
    strength = np.exp(rng.uniform(np.log(0.3), np.log(20.0), len(place)))
    named = rng.random(len(place)) < 1.0 / (1.0 + np.exp(-slope * (np.log(strength) - middle[place])))
    found, std, found_slope = detection(strength, place, named)
    assert np.all(np.abs(found - middle) < 3.0 * std)
    assert np.all(std < 0.12)
    assert found_slope == pytest.approx(slope, rel=0.25)


def test_detection_is_below_what_was_always_named_and_above_what_never_was() -> None:
    place = np.repeat([0, 1], 3)
    named = place == 0
    found, std, _ = detection(np.array([18.0, 7.0, 4.0] * 2), place, named)
    assert np.exp(found[0]) < 4.0
    assert np.exp(found[1]) > 18.0
    assert np.all(std > 0.2)


def test_families_pairs_and_false_names_are_counted() -> None:
    tilt = ["base_tilt", []]
    runs = [
        run(None, [], verdict="none_needed"),
        run(None, [], found=[tilt]),
        *[run("joint_zero_offset", [2], found=[["joint_zero_offset", [2]]]) for _ in range(3)],
        run("joint_zero_offset", [3], found=[tilt]),
        run("joint_zero_offset", [3], found=[tilt, ["joint_zero_offset", [3]]], verdict="undecided", next=[[0.0] * 6]),
        run("joint_zero_offset", [6], size=0.15, largest_share=1.0, strength=0.1),
        run("sign_reversed", [1], found=[["sign_reversed", [1]]], strength=None),
    ]
    body = summary(runs, 60.0)
    assert (body["clean_arms"], body["false_names"], body["time_under_power_s"]) == (2, 1, 120.0)
    entries = {(entry["name"], *entry["joints"]): entry for entry in body["effects"]}
    assert entries["joint_zero_offset", 2]["named"] == 3
    assert entries["joint_zero_offset", 2]["detection_size"] < 0.02
    assert entries["joint_zero_offset", 2]["recovered"]
    assert not entries["joint_zero_offset", 6]["recovered"], "its largest size is not visible"
    assert entries["sign_reversed", 1]["recovered"]
    families = {family["name"]: family for family in body["families"]}
    assert {"name": "joint_zero_offset", "joints": [6]} in families["gravity and geometry"]["missed"]
    assert families["wiring and settings"]["recovered"]
    (pair,) = body["confused"]
    assert (pair["effects"], pair["arms"]) == (["base_tilt", "joint_zero_offset"], 2)
    assert pair["separated_by"] == [[0.0] * 6]
    assert body["load"]["as_stated"]["inside"] == 8


def test_load_is_judged_by_its_own_intervals() -> None:
    wide = {"mass_kg": 100.0, "error": [3.0, 0.0, 0.0, 0.01], "std": [1.0, 0.001, 0.001, 0.001]}
    case = summary([run(None, [], estimate=wide), run(None, [], estimate=None)], 60.0)["load"]["as_stated"]
    assert (case["arms"], case["not_identified"], case["inside"], case["intervals"]) == (1, 1, 2, 4)
    assert case["mass_rms_error_share"] == pytest.approx(0.03)
    assert case["mass_std_share"] == pytest.approx(0.01)


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["--effects", "gravity_waves"], 2, "gravity_waves"),
        (["--effects", "velocity_friction"], 3, "velocity_friction"),
        (["--plan", "missing.json"], 3, "missing.json"),
        (["--plan", "moving.json"], 3, "moving.json"),
        (["--arm", "left"], 3, "left"),
        (["--resume"], 3, "out.json"),
    ],
)
def test_wrong_input_is_refused_before_an_arm_is_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], code: int, said: str
) -> None:
    shutil.copytree(SMALL, tmp_path / "small")
    monkeypatch.chdir(tmp_path)
    Path("moving.json").write_text('{"schema": 1, "motions": []}', encoding="utf-8")
    result = CliRunner().invoke(main, ["rehearse", "small/cell.toml", "-o", "out.json", *arguments])
    assert result.exit_code == code, result.output
    assert said in result.output
    assert not Path("out.json").exists()


def test_an_answer_is_not_replaced_and_an_edited_one_not_continued(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    body = {"schema": 1, "kind": "rehearsal", "runs": []}
    edited, resume = sealed(body) | {"arm": "x"}, ("--resume",)
    for stored, words, said in ((body, (), "--resume"), (edited, resume, "edited"), (body, resume, "no sha256")):
        Path("out.json").write_text(json.dumps(stored), encoding="utf-8")
        result = CliRunner().invoke(main, ["rehearse", str(SMALL / "cell.toml"), "-o", "out.json", *words])
        assert result.exit_code == 3
        assert said in result.output


def test_another_plan_is_not_continued(tmp_path: Path) -> None:
    plan, other = {"schema": 1, "kind": "rest_plan", "arm": "main", "duration_s": 60.0}, [0.0] * 6
    plan["poses"] = [{"pose": k, "purpose": "fit", "q_rad": [0.1 * k] * 6} for k in range(4)]
    (tmp_path / "plan.json").write_text(json.dumps(sealed(plan)), encoding="utf-8")
    earlier = {"cell_sha256": "0", "arm": "main", "plan": {"q_rad": [other]}, "runs": []}
    with pytest.raises(InputError, match="another cell"):
        rehearse(SMALL / "cell.toml", plan_file=tmp_path / "plan.json", earlier=earlier)


def test_simulator_that_refuses_is_named() -> None:
    with pytest.raises(ConfigError, match="simulator"):
        rehearse(SMALL.parent / "bench" / "cell.toml", effects={"base_tilt"})
