"""What a typed line and a value of an answer file may look like."""

from __future__ import annotations

import re
from contextlib import suppress
from functools import partial

import pytest

from drives.draft.questions import QUESTIONS, answer_form
from drives.toml_text import toml_string
from gateway.errors import ConfigError
from gateway.newcell import questions
from gateway.newcell.answers import CellAnswers, given_answers, profile_answers
from gateway.newcell.forms import plain_text

#: Replies to each question, all of one value: as typed, and as an answer file may have them.
SPELLINGS = {
    "name": ["cell 5", '"cell 5"'],
    "robot": ["dh", '"dh"'],
    "tip": ["link_6", '"link_6"'],
    "dh_convention": ["modified", '"modified"'],
    "dh_alpha_rad": ["0, 1.5", "[0, 1.5]"],
    "dh_a_m": ["0, 0.1", "[0, 0.1]"],
    "dh_d_m": ["0.3, 0", "[0.3, 0.0]"],
    "dh_theta_offset_rad": ["0, 0", "[0, 0]"],
    "bus": ["pcan:PCAN_USBBUS1,bitrate=500000", '"pcan:PCAN_USBBUS1,bitrate=500000"'],
    "offline": ["true"],
    "eds": ["/a.eds, /b.eds", '["/a.eds", "/b.eds"]'],
    "sync_period_s": ["10 ms", "0.01 s", "0.01"],
    "pacing": ["lockstep", '"lockstep"'],
    "nodes": ["5-6", "5, 6", "[5, 6]", "0x05, 6"],
    "profile": ["copley", '["copley", "copley"]', "copley, copley"],
    "gear_ratio": ["1:160", "160:1", "160", "[160, 160]", "160, 160", "1:160, 160"],
    "gear_efficiency": ["85 %", "0.85", "85 percent", "85, 85 %", '{ value = 0.85, source = "sheet, p. 4" }'],
    "torque_constant_nm_per_a": ["210 mNm/A", "0.21 Nm/A", "0.21", "[0.21, 0.21]"],
    "position_sign": ["-1", "-1, -1", "[-1, -1]"],
    "torque_sign": ["1", "[1, 1]"],
    "zero_offset_rad": ["1500 mrad", "1.5 rad", "1.5"],
    "position_limit_rad": ["-90, 90 deg", "[-1.5707963267948966, 1.5707963267948966]"],
    "speed_limit_rad_s": ["0.5", "0.5 rad/s", "[0.5, 0.5]"],
    "torque_limit_nm": ["1.5 kNm", "1500 Nm", "1500"],
    "inertials": ["prior:0.1", '"prior:0.1"'],
    "mounting": ["ceiling", "0, 0, 9.80665", "[0, 0, 9.80665]"],
    "flange_xyz_m": ["0, 0, 60 mm", "0, 0, 6 cm", "[0, 0, 0.06]"],
    "flange_rpy_rad": ["0, 1.5, 0", "0, 1500, 0 mrad", "[0, 1.5, 0] rad"],
    "rated_load_kg": ["5000 g", "5 kg", "5", "0.005 t"],
    "max_load_kg": ["none", '"none"'],
    "max_load_com_m": ["0, 0, 250 mm", "[0, 0, 0.25]"],
    "poses": ["{ count = 5 }"],
}
#: The same of the questions about a drive.
OF_DRIVE = {
    "torque_object": ["0x30D1:02"],
    "torque_kind": ["milliampere", '"milliampere"'],
    "torque_nature": ["demand"],
    "rated_unit": ["1e-3", "0.001"],
    "rated_value": ["12", "12.0"],
    "internal_unit_a": ["0.5"],
    "current_reference": ["rms", '"rms"'],
    "torque_constant_per": ["peak"],
    "torque_source": ["manual, p. 84; table 2"],
    "counts_per_revolution": ["4096"],
    "velocity_unit_rad_s": ["0.010471975511965977"],
    "lost_heartbeat": ["quick stop"],
    "cyclic_mode": ["7"],
}


def replies(lines, folder, read, key):
    """What is read from replies in an answer file: each as a text, and as the value that TOML makes of it."""
    for line in lines:
        for value in (toml_string(line), line):
            (folder / "answers.toml").write_text(f"{key} = {value}\n", encoding="utf-8")
            with suppress(ConfigError):
                yield read(folder / "answers.toml", {})


def settled(question, given=None, ask=None):
    answers = CellAnswers(given or {}, "answers", ask)
    answers.settle([(question, None)], 2)
    return answers.taken[question.key]


@pytest.mark.parametrize("question", questions.ALL, ids=lambda question: question.key)
def test_terminal_and_answer_file_take_the_same_forms(tmp_path, question):
    lines = SPELLINGS[question.key]
    first = settled(question, ask=lambda *asked: asked[-1](lines[0])).value
    of_cell = partial(given_answers, known=questions.KEYS)
    from_file = [settled(question, given) for given in replies(lines, tmp_path, of_cell, question.key)]
    typed_in = [settled(question, ask=lambda *asked, line=line: asked[-1](line)) for line in lines]
    assert len(from_file) >= len(lines)
    for answer in (*from_file, *typed_in):
        assert answer.value == first
    sourced = f"{lines[0]}; data sheet p. 4"
    (tmp_path / "answers.toml").write_text(f"{question.key} = {toml_string(sourced)}\n", encoding="utf-8")
    given = of_cell(tmp_path / "answers.toml", {})
    for answer in (settled(question, given), settled(question, ask=lambda *asked: asked[-1](sourced))):
        assert (answer.value, answer.source) == (first, "data sheet p. 4")


@pytest.mark.parametrize("key", sorted({*OF_DRIVE, *(question.key for question in QUESTIONS)}))
def test_terminal_and_answer_file_take_the_same_forms_about_a_drive(tmp_path, key):
    lines = OF_DRIVE[key]
    typed_in = [answer_form(key)(plain_text(line), 0) for line in lines]
    from_file = [getattr(answers, key) for answers in replies(lines, tmp_path, profile_answers, key)]
    assert len(from_file) >= len(lines)
    assert {*typed_in, *from_file} == {typed_in[0]}


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('torque_kind = "newton"', "line 1: torque_kind"),
        ("rated_unit = true", "line 1: rated_unit"),
        ("torque_kind = ", "not valid TOML"),
        ('counts_object = "6077"', "line 1: counts_object"),
    ],
)
def test_an_answer_about_a_drive_that_is_none_is_named(tmp_path, text, says):
    (tmp_path / "answers.toml").write_text(text)
    with pytest.raises(ConfigError, match=says):
        profile_answers(tmp_path / "answers.toml", {})


@pytest.mark.parametrize(
    ("question", "line", "says"),
    [
        (questions.GEAR_RATIO, "nan", "which is not a number"),
        (questions.GEAR_RATIO, "true", "which is not a number"),
        (questions.GEAR_RATIO, "0:160", "1:160"),
        (questions.GEAR_RATIO, "0", "gear_ratio must not be 0"),
        (questions.GEAR_EFFICIENCY, "85 Nm", "1 %"),
        (questions.TORQUE_CONSTANT, "210 Nm", "for example 1 Nm/A, 1 mNm/A"),
        (questions.TORQUE_CONSTANT, "-1", "must be positive"),
        (questions.POSITION_SIGN, "0", "position_sign"),
        (questions.SPEED_LIMIT, "0", "must be more than 0"),
        (questions.NODES, "1, 128", "must be at most 127"),
        (questions.NODES, "3, 3", "node id 3 is used for more than one axis"),
        (questions.NODES, "1-", "example: 1-6"),
        (questions.NODES, "100-140", "give one per axis; example: 1-6"),
        (questions.POSITION_LIMIT, "[[-1, 1]]", "neither a pair"),
        (questions.POSITION_LIMIT, "2, 1", "is not below"),
        (questions.MOUNTING, "wall", "not a list of three numbers or no `floor`"),
        (questions.PROFILE, "3", "neither a text nor a list of texts"),
        (questions.PACING, "fast", "pacing"),
        (questions.SYNC_PERIOD, "0", "sync_period_s"),
        (questions.RATED_LOAD, "-1", "rated_load_kg must be positive"),
        (questions.INERTIALS, "good", "inertials"),
    ],
)
def test_a_reply_that_is_refused_at_the_terminal_is_refused_in_a_file(tmp_path, question, line, says):
    (tmp_path / "answers.toml").write_text(f"{question.key} = {toml_string(line)}\n")
    given = given_answers(tmp_path / "answers.toml", {}, questions.KEYS)
    with pytest.raises(ConfigError, match=rf"answers\.toml line 1: .*{re.escape(says)}"):
        settled(question, given)
    with pytest.raises(ConfigError, match=re.escape(says)):
        settled(question, ask=lambda *asked: asked[-1](line))
