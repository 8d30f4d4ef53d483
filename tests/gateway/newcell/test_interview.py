"""What is offered from drives and files: ratings, limits, node ids, profiles, and what does not fit together."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drives.values import Identity
from gateway.cell.config import parse_cell
from gateway.errors import ConfigError
from gateway.model.robot import robot_from_urdf, with_flange
from gateway.newcell import offers, questions
from gateway.newcell.answers import CellAnswers, GivenAnswer
from gateway.newcell.cell_text import cell_text, left_over
from gateway.newcell.interview import interview
from gateway.newcell.nodes import Read, SeenNode, nodes_in
from gateway.newcell.offers import PLACEHOLDER

OWN = Path(__file__).parents[3] / "examples" / "own"
#: 1 Nm and 2 A rated, three times that at most; 2 ** 17 counts a turn; 3000 rpm.
STANDARD = {
    (0x6075, 0): 2000,
    (0x6076, 0): 1000,
    (0x6072, 0): 3000,
    (0x608F, 1): 131072,
    (0x608F, 2): 1,
    (0x6080, 0): 3000,
}


def node(node_id, values=None, profile="generic-cia402", **identity):
    who = Identity(node_id, 0x0192, 0x123, 7, 1, 99, "drive", None, "1.2")
    read = {address: Read(value, "read from drive") for address, value in (values or STANDARD).items()}
    return SeenNode(node_id, replace(who, **identity), read, (profile,), f"node {node_id}")


class Bench:
    """Drives that are said to be there."""

    def __init__(self, on_bus=(), in_files=()):
        self.on_bus, self.in_files = tuple(on_bus), tuple(in_files)

    def nodes(self, spec):
        del spec
        return tuple(replace(each, values={}) for each in self.on_bus)

    def values(self, spec, wanted):
        del spec
        by_id = {each.node_id: each for each in self.on_bus}
        return {node_id: dict(by_id[node_id].values) for node_id in wanted}

    def files(self, paths):
        del paths
        return self.in_files


def asked(bench, **answers):
    """Draft of the arm of the examples with some answers."""
    answers_ = {"robot": str(OWN / "arm.urdf"), "bus": "virtual:x", "gear_ratio": 100} | answers
    said = CellAnswers({key: GivenAnswer(value, key, Path()) for key, value in answers_.items()}, "answers")
    return interview(said, bench, "cell", lambda text: None)


def six(values=None, **more):
    return [node(11 + axis, values, **more) for axis in range(6)]


def test_ratings_give_torque_constant_and_limits_as_guesses():
    taken = asked(Bench(six())).answers.taken
    constant = taken["torque_constant_nm_per_a"]
    assert constant.value == (0.5,) * 6
    assert constant.guessed
    # efforts of the URDF where the drives give more than that: 1 Nm x 3 x 100
    assert taken["torque_limit_nm"].value == (140, 140, 75, 26, 22, 14)
    assert not taken["torque_limit_nm"].guessed
    assert taken["speed_limit_rad_s"].value == (0.5,) * 6


def test_what_the_drives_cannot_give_is_no_limit():
    weak = STANDARD | {(0x6072, 0): 200, (0x6080, 0): 300}
    taken = asked(Bench(six(weak))).answers.taken
    assert taken["torque_limit_nm"].value == (20, 20, 20, 20, 20, 14)
    assert all(
        math.isclose(value, 300 * math.pi / 30 / 100, rel_tol=1e-3) for value in taken["speed_limit_rad_s"].value
    )


def test_limits_of_the_drives_narrow_those_of_the_urdf():
    turn = 131072 * 100 / (2 * math.pi)  # counts per rad of the joint
    ends = {(0x607D, 1): round(-2.0 * turn), (0x607D, 2): round(1.0 * turn)}
    taken = asked(Bench(six(STANDARD | ends)), position_sign=[1, -1, 1, 1, 1, 1], zero_offset_rad=[0, 0.1, 0, 0, 0, 0])
    limits = taken.answers.taken["position_limit_rad"].value
    # 1 % of the range inside of it, to four digits
    assert limits[0] == pytest.approx((-1.97, 0.97), abs=1e-3)
    # inverts position and moved: 0.1 - 1.0 to 0.1 + 2.0, of which the URDF allows 1.9
    assert limits[1] == pytest.approx((-0.87, 1.9), abs=1e-3)
    for shift in ({(0x607C, 0): 5}, {(0x607E, 0): 0x80}):  # whose meaning is not certain
        shifted = asked(Bench(six(STANDARD | ends | shift)))
        assert shifted.answers.taken["position_limit_rad"].value[0] == (-2.9, 2.9)


def test_ids_ascend_and_are_a_guess_but_those_of_files_are_none():
    on_bus = asked(Bench(reversed(six()))).answers.taken["nodes"]
    assert on_bus.value == (11, 12, 13, 14, 15, 16)
    assert on_bus.guessed
    stored = asked(Bench(in_files=six()), offline=True).answers.taken["nodes"]
    assert stored.value == (11, 12, 13, 14, 15, 16)
    assert not stored.guessed


def test_a_profile_of_the_maker_is_taken_and_a_general_one_is_a_guess():
    assert asked(Bench(six())).answers.taken["profile"].guessed
    made = asked(Bench(six(profile="maxon-epos4")), torque_constant_nm_per_a=0.05).answers.taken["profile"]
    assert made.value == ("maxon-epos4",) * 6
    assert not made.guessed


def test_what_is_missing_or_does_not_fit_is_said():
    there = [*six()[:5], node(40)]
    gears = STANDARD | {(0x6091, 1): 50, (0x6091, 2): 1}
    there[0] = node(11, gears)
    other = node(None, vendor_id=0x999)
    draft = asked(Bench(there, [replace(other, node_id=None, name="x.eds")]), nodes=[11, 12, 13, 14, 15, 16])
    remarks = "\n".join(entry.why for entry in left_over(draft))
    assert "node 16: no answer" in remarks
    assert "node 40: on the bus, but not an axis of this arm" in remarks
    assert "x.eds belongs to another device: vendor id 0x999, node 11 has 0x123" in remarks
    assert "node 11: 0x6091 is 50:1; set it to 1:1" in remarks
    assert draft.nodes[5] is not None
    assert draft.nodes[5].name == "x.eds"


def test_a_profile_that_its_data_sheet_contradicts_is_said(tmp_path):
    text = (OWN / "drive.eds").read_text(encoding="utf-8")
    head, rest = text.split("[6007]\n", 1)
    (tmp_path / "x.eds").write_text(head + rest[rest.index("[") :], encoding="utf-8")
    sheets = nodes_in([tmp_path / "x.eds", OWN / "drive.eds"])
    for sheet, expected in zip(sheets, ([True], []), strict=True):
        draft = asked(Bench(six(), [sheet]), profile=str(OWN / "bench" / "drive.toml"), torque_constant_nm_per_a=0.1)
        remarks = [remark for remark in draft.remarks if "contradict" in remark]
        assert [
            "bench-drive and x.eds contradict each other: 6007:00 is not in it" in each for each in remarks
        ] == expected


def test_a_gear_that_all_drives_reckon_with_is_offered():
    gears = STANDARD | {(0x6091, 1): 50, (0x6091, 2): 1}
    said = {"robot": str(OWN / "arm.urdf"), "bus": "virtual:x"}
    answers = CellAnswers({key: GivenAnswer(value, key, Path()) for key, value in said.items()}, "answers")
    draft = interview(answers, Bench(six(gears)), "cell", lambda text: None)
    assert draft.answers.value(questions.GEAR_RATIO) == (50,) * 6


def test_too_few_drives_and_no_terminal_to_ask_which():
    with pytest.raises(ConfigError, match="nodes is missing"):
        asked(Bench(six()[:5]))


def test_a_dcf_says_its_node_and_numbers_below_zero(tmp_path):
    text = (OWN / "drive.eds").read_text(encoding="utf-8")
    head, tail = text.split("[607Dsub1]\n", 1)
    spelled = f"{head}[607Dsub1]\nParameterValue=0xFFFFFC18\n{tail}\n[DeviceComissioning]\nNodeID=0x0B\n"
    (tmp_path / "n.dcf").write_text(spelled, encoding="utf-8")
    (stored,) = nodes_in([tmp_path / "n.dcf"])
    assert stored.node_id == 11
    low = stored.read("position_limit_min")
    assert low is not None
    assert (low.value, low.source) == (-1000, "read from n.dcf, 0x607D")
    assert stored.identity.vendor_id == 0x3E7
    (plain,) = nodes_in([OWN / "drive.eds"])
    assert plain.node_id is None


def test_drives_that_give_less_than_a_placeholder_of_the_urdf_decide(tmp_path):
    """1 Nm x 3 x 100 = 300 Nm of the drives: below the 1000 Nm that the exporter filled in, above its 100 Nm."""
    for effort, value, placeholder in ((1000, 300.0, False), (100, 100.0, True)):
        urdf = tmp_path / f"{effort}.urdf"
        urdf.write_text(re.sub(r'effort="\d+"', f'effort="{effort}"', (OWN / "arm.urdf").read_text()))
        limit = asked(Bench(six()), robot=str(urdf)).answers.taken["torque_limit_nm"]
        assert limit.value == (value,) * 6
        assert limit.guessed
        assert limit.source.startswith(PLACEHOLDER) is placeholder


def test_what_a_sheet_states_that_cannot_be_used_is_said(tmp_path):
    (tmp_path / "n.eds").write_text((OWN / "drive.eds").read_text(encoding="utf-8") + "\n[5555]\nParameterName=x\n")
    said = []
    (stored,) = nodes_in([tmp_path / "n.eds"])
    answers_ = {"robot": str(OWN / "arm.urdf"), "bus": "virtual:x", "gear_ratio": 100}
    answers = CellAnswers({key: GivenAnswer(value, key, Path()) for key, value in answers_.items()}, "answers")
    interview(answers, Bench(six(), [stored]), "cell", said.append)
    assert any("[5555]" in line and "DataType is missing" in line for line in said)


def test_an_unturned_flange_is_marked_as_assumed():
    draft = asked(Bench(six()), flange_xyz_m=[0, 0, 0.1])
    turn = draft.answers.taken["flange_rpy_rad"]
    assert turn.value == (0.0, 0.0, 0.0)
    assert turn.guessed
    assert "flange_rpy_rad" in {entry.key for entry in left_over(draft)}
    text = cell_text(draft, str)
    assert "flange_rpy_rad = [0, 0, 0]   # assumed: not rotated in the last link" in text
    (arm,) = parse_cell(text, "cell.toml").arm
    assert arm.flange_origin == "assumed: not rotated in the last link"


def test_a_flange_that_was_turned_is_not():
    draft = asked(Bench(six()), flange_xyz_m=[0, 0, 0.1], flange_rpy_rad=[0, 1.5708, 0])
    assert "flange_rpy_rad" not in {entry.key for entry in left_over(draft)}
    (arm,) = parse_cell(cell_text(draft, str), "cell.toml").arm
    assert arm.flange_rpy_rad == (0, 1.5708, 0)
    assert arm.flange_origin == "cell file"


def test_the_flange_of_the_description_is_offered_with_its_turn():
    robot = robot_from_urdf((OWN / "arm.urdf").read_text(encoding="utf-8"), "arm.urdf")
    assert offers.flange_frame(replace(robot, frames=())) is None
    tool = with_flange(robot, (0.1, 0.0, 0.02), (0.3, math.pi / 4, -1.2)).flange
    frames = (("cover", np.eye(4)), ("left_flange", 2 * np.eye(4)), ("left_tool0", tool))
    xyz, rpy = offers.flange_frame(replace(robot, frames=frames)) or (None, None)
    assert xyz is not None
    assert rpy is not None
    assert xyz.value == (0.1, 0.0, 0.02)
    assert rpy.value == pytest.approx((0.3, math.pi / 4, -1.2))
    assert xyz.source == rpy.source == "URDF, frame left_tool0"
    (kept,) = (each for each in (offers.flange_frame(replace(robot, frames=frames[:2])) or ())[:1])
    assert kept.source == "URDF, frame left_flange"


def test_the_tool0_of_a_urdf_is_the_flange_of_the_cell():
    draft = asked(Bench(six()))
    (arm,) = parse_cell(cell_text(draft, str), "cell.toml").arm
    (pose,) = (pose for name, pose in draft.robot.frames if name == "tool0")
    assert arm.flange_xyz_m == pytest.approx(tuple(pose[:3, 3]))
    assert not draft.answers.taken["flange_xyz_m"].guessed


def test_the_turn_of_the_flange_is_asked_where_a_flange_is_stated(tmp_path):
    questions_asked = []
    plain = tmp_path / "arm.urdf"
    plain.write_text((OWN / "arm.urdf").read_text(encoding="utf-8").replace("tool0", "face"), encoding="utf-8")

    def ask(question, _offer, _number, _most, read):
        questions_asked.append(question.key)
        return read([0, 0, 0.1]) if question.key == "flange_xyz_m" else None

    answers_ = {"robot": str(plain), "bus": "virtual:x", "gear_ratio": 100}
    said = CellAnswers({key: GivenAnswer(value, key, Path()) for key, value in answers_.items()}, "answers", ask)
    interview(said, Bench(six()), "cell", lambda text: None)
    assert {"flange_xyz_m", "flange_rpy_rad", "rated_load_kg"} <= set(questions_asked)
    assert "max_load_kg" not in questions_asked


def test_the_rated_load_is_written_and_is_the_heaviest_unless_stated():
    draft = asked(Bench(six()), rated_load_kg={"value": 5, "source": "plate"})
    (arm,) = parse_cell(cell_text(draft, str), "cell.toml").arm
    assert arm.rated_load_kg is not None
    assert (arm.rated_load_kg.value, arm.rated_load_kg.source, arm.max_load_kg) == (5, "plate", 5)
    assert "max_load_com_m" in {entry.key for entry in left_over(draft)}
    draft = asked(Bench(six()), rated_load_kg=5, max_load_kg=3, max_load_com_m="0, 0, 250 mm")
    (arm,) = parse_cell(cell_text(draft, str), "cell.toml").arm
    assert (arm.max_load_kg, arm.max_load_com_m) == (3, (0, 0, 0.25))
    unrated = asked(Bench(six()))
    assert "rated_load_kg" in {entry.key for entry in left_over(unrated)}
    assert parse_cell(cell_text(unrated, str), "cell.toml").arm[0].rated_load_kg is None


@pytest.mark.parametrize(
    ("answers", "says"),
    [
        ({"rated_load_kg": 3, "max_load_kg": 3000}, r"max_load_kg: 3000 kg .*\(5 x rated_load_kg of 3 kg\)"),
        ({"rated_load_kg": 3, "max_load_com_m": [0, 0, 250]}, r"max_load_com_m: 250 m is .*write .*0\.25"),
    ],
)
def test_loads_and_torques_in_another_unit_are_refused_where_they_are_answered(answers, says):
    with pytest.raises(ConfigError, match=says):
        asked(Bench(six()), **answers)
