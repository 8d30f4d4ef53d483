"""Drafts of profiles: they hold what the sheet says; unstated values keep the drive from being moved."""

from __future__ import annotations

import pytest

from drives.draft.answers import ProfileAnswers, address_of
from drives.draft.device import Device, ask_drive, device_of_sheet, unit_rad_s
from drives.draft.questions import QUESTIONS, next_question, open_questions
from drives.draft.text import draft, profile_name
from drives.errors import ProfileError
from drives.profile_file import PROFILE_FOLDER, find_profile, parse_profile
from drives.scaling import Constants, motor_scale
from drives.values import Identity

GENERIC = (PROFILE_FOLDER / "generic-cia402.eds").read_text()
#: A strange drive: another make, current in peak ampere, 4096 counts that no object shows, speed in 0.001 rpm.
STRANGE = (
    GENERIC.replace("[608F]", "[508F]")
    .replace("[608Fsub", "[508Fsub")
    .replace("VendorNumber=0", "VendorNumber=0x1234")
    .replace("ProductNumber=0", "ProductNumber=0x77")
    .replace("RevisionNumber=0", "RevisionNumber=0x20000")
    .replace("VendorName=any", "VendorName=Höhn & Co")
    + "\n[60A9]\nParameterName=SI unit velocity\nObjectType=0x7\nDataType=0x0007\nAccessType=rw\n"
    "DefaultValue=0xFDB44700\nPDOMapping=0\n"
)
TORQUE = {
    "torque_kind": "permille_rated_torque",
    "torque_nature": "measured",
    "rated_unit": 1e-6,
    "torque_source": "manual p. 84",
}
CURRENT = TORQUE | {
    "torque_kind": "permille_rated_current",
    "rated_unit": 1e-3,
    "current_reference": "peak",
    "torque_constant_per": "rms",
}


@pytest.fixture
def device(tmp_path):
    def device(text=GENERIC, encoding="utf-8"):
        path = tmp_path / "drive.eds"
        path.write_bytes(text.encode(encoding))
        return device_of_sheet(path)

    return device


def profile_of(device, **answers):
    return parse_profile(draft(device, ProfileAnswers.model_validate(answers), "mine"), "mine.toml")


def test_a_draft_of_a_sheet_alone_reads_and_refuses_motion(device):
    profile = profile_of(device())
    assert profile.torque.assumed
    assert (profile.torque.nature, profile.torque.basis) == ("unknown", "assumed")
    assert any("0x6077:00" in obstacle and "[torque]" in obstacle for obstacle in profile.obstacles)
    assert "torque_kind" in profile.torque.source


def test_a_drive_that_coasts_without_its_master_is_not_moved(device):
    profile = profile_of(device(), **TORQUE, lost_heartbeat="disable voltage")
    assert profile.heartbeat.abort_connection == 2
    assert len(profile.obstacles) == 1
    assert "abort_connection = 2 (disable voltage) lets a moving axis coast" in profile.obstacles[0]


def test_answers_make_it_whole(device):
    """0x6076 shows 512871 uNm, the word 500 per mille of it."""
    profile = profile_of(device(), **TORQUE, lost_heartbeat="quick stop")
    assert profile.obstacles == ()
    assert (profile.torque.source, profile.torque.basis) == ("manual p. 84", "manual")
    assert profile.heartbeat.abort_connection == 3
    rated_nm = 512871 * profile.torque.rated.unit
    scale = motor_scale(profile, Constants(rated_nm, None, None, 65536.0), 1.0)
    assert 500 * scale.torque_nm == pytest.approx(0.2564355)


def test_a_current_of_a_strange_drive(device):
    """1000 per mille are 4 A peak, 2.828 A rms; at 0.5 Nm per A rms that is 1.414 Nm."""
    profile = profile_of(device(STRANGE), **CURRENT, counts_per_revolution=4096, position_source="encoder p. 2")
    assert profile.obstacles == ()
    assert profile.torque.rated.object.index == 0x6075
    assert (profile.identity.vendor_id, profile.identity.product_code) == (0x1234, 0x77)
    assert profile.identity.revision_min == 0x20000
    scale = motor_scale(profile, Constants(4.0, None, None, 4096.0), 0.5)
    assert 1000 * scale.torque_nm == pytest.approx(1.41421356)
    assert profile.velocity.unit_rad_s.value == pytest.approx(0.10471975511965977e-3)
    assert "60A9" in profile.velocity.unit_rad_s.source
    assert profile.position.counts_per_revolution.value == 4096
    assert profile.position.counts_per_revolution.source == "encoder p. 2"


def test_a_sheet_in_an_older_encoding_is_read(device):
    assert profile_of(device(STRANGE, "latin-1")).description.startswith("Höhn & Co")


@pytest.mark.parametrize("left_out", sorted(CURRENT))
def test_one_answer_short_is_not_enough(device, left_out):
    answers = {key: value for key, value in CURRENT.items() if key != left_out}
    profile = profile_of(device(), **answers)
    assert profile.torque.assumed
    assert profile.obstacles
    assert left_out in {question.key for question in open_questions(device(), ProfileAnswers.model_validate(answers))}


@pytest.mark.parametrize("answers", [{"warning_codes": "0x4310, 0x4310"}, {"ramp_counts_s2": 10.0}])
def test_an_answer_that_says_nothing_is_refused(device, answers):
    with pytest.raises(ProfileError, match="0x4310 is listed twice|answer velocity_unit_rad_s"):
        profile_of(device(), **TORQUE, **answers)


def test_a_source_that_says_assumed_is_none(device):
    assert profile_of(device(), **TORQUE | {"torque_source": "Assumed, as always"}).obstacles


def test_a_trial_on_the_drive_is_a_basis(device):
    assert profile_of(device(), **TORQUE | {"torque_source": "measured with a lever"}).torque.basis == "measured"


def test_unknown_counts_refuse_motion(device):
    (obstacle,) = profile_of(device(STRANGE), **TORQUE).obstacles
    assert "counts per motor revolution" in obstacle
    assert "[position]" in obstacle


@pytest.mark.parametrize(("counts", "turns", "asks"), [(1, 1, True), (1, None, True), (0, 1, True), (4096, 1, False)])
def test_counts_that_a_drive_answers_as_one_for_one_are_asked(device, counts, turns, asks):
    identity = Identity(3, 0x20192, 0x1234, 0x77, 0x30000, 9, "x", "h", "1.2")
    profile = profile_of(Device(device(GENERIC).sheet, identity, {(0x608F, 1): counts, (0x608F, 2): turns}), **TORQUE)
    assert any("counts per motor revolution" in each for each in profile.obstacles) is asks


def test_counts_stand_in_an_object_of_the_make(device):
    text = STRANGE + "\n[3000]\nParameterName=r\nObjectType=0x7\nDataType=0x0007\nAccessType=ro\nPDOMapping=0\n"
    profile = profile_of(device(text), **TORQUE, counts_object="0x3000")
    counts = profile.position.counts_per_revolution
    assert (counts.object.index, counts.object.type, counts.per) == (0x3000, "u32", None)
    with pytest.raises(ProfileError, match="0x3001:00"):
        profile_of(device(text), **TORQUE, counts_object="0x3001")


def test_a_rated_current_is_read_from_a_manufacturer_object(device):
    text = STRANGE + "\n[203B]\nParameterName=r\nObjectType=0x7\nDataType=0x0007\nAccessType=ro\nPDOMapping=0\n"
    answers = CURRENT | {"rated_object": "0x203B", "counts_per_revolution": 4096}
    profile = profile_of(device(text), **answers)
    assert (profile.torque.rated.object.index, profile.torque.rated.unit, profile.obstacles) == (0x203B, 0.001, ())
    with pytest.raises(ProfileError, match="0x203C"):
        profile_of(device(text), **answers | {"rated_object": "0x203C"})


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("[1016]", "[2016]", "0x1016"),
        ("[607A]", "[507A]", "0x607A"),
        ("[1A00]", "[2A00]", "0x1A00"),
    ],
)
def test_a_drive_that_lacks_what_bringing_up_needs_is_read_and_not_moved(device, old, new, says):
    text = GENERIC.replace(old, new).replace(old[:-1] + "sub", new[:-1] + "sub")
    profile = profile_of(device(text), **TORQUE)
    assert any(says in reason for reason in profile.no_motion)
    assert profile.obstacles == profile.no_motion


def test_a_torque_that_no_pdo_carries_is_read_and_not_moved(device):
    at = GENERIC.index("[6077]")
    text = GENERIC[:at] + GENERIC[at:].replace("PDOMapping=1", "PDOMapping=0", 1)
    assert profile_of(device(text), **TORQUE).no_motion == ("6077:00 cannot be mapped to a PDO",)


@pytest.mark.parametrize(("modes", "moves"), [("0x225", False), ("0x3A5", True), ("0", True)])
def test_a_drive_without_csp_is_read_and_not_moved(device, modes, moves):
    at = GENERIC.index("[6502]")
    section = GENERIC[at:].replace("DefaultValue=", f"DefaultValue={modes}", 1)
    profile = profile_of(device(GENERIC[:at] + section), **TORQUE)
    assert (profile.no_motion == ()) is moves
    assert moves or "0x225" in profile.no_motion[0]


def test_what_the_drive_says_goes_before_its_sheet(device):
    identity = Identity(3, 0x20192, 0x1234, 0x77, 0x30000, 9, "x", "h", "1.2")
    sheet = device(STRANGE).sheet
    asked = Device(sheet, identity, {(0x6076, 0): 2000, (0x6502, 0): 0x01, (0x60A9, 0): 0x00B44700})
    profile = profile_of(asked, **TORQUE, counts_per_revolution=4096)
    assert profile.identity.revision_min == 0x30000
    assert "node 3 (firmware 1.2), read from drive" in profile.source
    assert profile.velocity.unit_rad_s.value == pytest.approx(0.10471975511965977)
    assert "read from node 3 = 0x1" in profile.no_motion[0]
    denied = Device(sheet, identity, {(0x607A, 0): None})
    assert any("0x607A" in reason for reason in profile_of(denied, **TORQUE).no_motion)


def test_a_drive_without_an_abort_option_or_torque_offset_may_be_moved(device):
    text = GENERIC.replace("[6007]", "[5007]").replace("[60B2]", "[50B2]")
    profile = profile_of(device(text), **TORQUE)
    assert profile.heartbeat.abort_connection is None
    assert not {0x6007, 0x60B2} & set(profile.write.allow)
    assert profile.obstacles == ()


def test_a_drive_that_states_interpolated_position_alone_is_moved_in_it(device):
    at = GENERIC.index("[6502]")
    text = GENERIC[:at] + GENERIC[at:].replace("DefaultValue=", "DefaultValue=0x43", 1)
    lines = ["[60C1]", "ParameterName=Interpolation data record", "ObjectType=0x8", "SubNumber=2", "[60C1sub0]"]
    lines += ["ParameterName=Number", "ObjectType=0x7", "DataType=0x0005", "AccessType=ro", "DefaultValue=1"]
    lines += ["[60C1sub1]", "ParameterName=Setpoint", "ObjectType=0x7", "DataType=0x0004", "AccessType=rw"]
    with_record = profile_of(device("\n".join([text, *lines, "PDOMapping=1"])), **TORQUE)
    assert (with_record.state_machine.cyclic_mode, with_record.obstacles) == (7, ())
    assert "0x60C1" in profile_of(device(text), **TORQUE).no_motion[0]


def test_what_a_manual_says_of_mode_statusword_and_warnings_is_taken(device):
    typed = {"cyclic_mode": "7", "ignored_status": "0x0800"}
    profile = profile_of(device(), **typed, warning_codes="0x4310, 0x4390")
    machine = profile.state_machine
    assert (machine.cyclic_mode, machine.ignored_status) == (7, 0x0800)
    assert [(entry.code, entry.warning) for entry in profile.emcy] == [(0x4310, True), (0x4390, True)]


def test_a_drive_with_node_guarding_alone_watches_that(device):
    text = GENERIC.replace("[1016]", "[2016]").replace("[1016sub", "[2016sub")
    for index, kind in (("100C", "0x0006"), ("100D", "0x0005")):
        text += f"\n[{index}]\nParameterName=x\nObjectType=0x7\nDataType={kind}\nAccessType=rw\nPDOMapping=0\n"
    profile = profile_of(device(text), **TORQUE)
    assert (profile.heartbeat.watchdog, profile.obstacles) == ("node guarding", ())


@pytest.mark.parametrize("code", [0x060A0023, 0x08000020, 0x06060000, 0x06010001, 0x08000000, 0x06020000])
def test_an_object_that_the_drive_refuses_to_give_stays_an_open_question(bus, make_slave, code):
    """0x6075, the rated current, of a drive that the sheet of the package describes."""
    slave = make_slave(1)
    slave.refused[0x6075, 0] = code
    asked = ask_drive(bus, 1, device_of_sheet(PROFILE_FOLDER / "generic-cia402.eds"))
    assert asked.live.get((0x6075, 0)) is None
    assert asked.live[0x6076, 0] == 2000


def test_a_sheet_without_torque_is_asked_for_one(device):
    text = GENERIC.replace("[6077]", "[5077]").replace("[6078]", "[5078]")
    assert "torque_object" in {question.key for question in open_questions(device(text), ProfileAnswers())}
    with pytest.raises(ProfileError, match="torque_object"):
        draft(device(text), ProfileAnswers(), "mine")
    answers = TORQUE | {"torque_object": "0x5077:00"}
    assert profile_of(device(text), **answers).torque.object.index == 0x5077


def test_questions_follow_from_answers_and_end(device):
    asked: list[str] = []
    answers = ProfileAnswers()
    typed = {key: str(value) for key, value in CURRENT.items()}
    while (question := next_question(device(), answers, asked)) is not None:
        asked.append(question.key)
        if question.key in typed:
            answers = answers.model_copy(update={question.key: question.form(typed[question.key], 0)})
    assert asked == [
        "torque_kind", "torque_nature", "rated_unit", "current_reference", "torque_constant_per", "torque_source",
        "velocity_unit_rad_s", "lost_heartbeat",
    ]  # fmt: skip
    assert all(question.ways for question in QUESTIONS)


@pytest.mark.parametrize(
    ("code", "unit"),
    [
        (0x00B44700, 0.10471975511965977),
        (0x00B40300, 6.283185307179586),
        (0x00100300, 1.0),
        (0xFF100300, 0.1),
        (0x00000000, None),
        (0x00B50300, None),
        (0x00B44701, None),
    ],
)
def test_units_of_speed(code, unit):
    """CiA 303-2: B4 revolution, 10 radian, 47 minute, 03 second, the top byte a power of ten."""
    assert unit_rad_s(code) == (None if unit is None else pytest.approx(unit))


def test_small_things():
    assert address_of("0x30D1:02") == (0x30D1, 2)
    assert address_of("0x6077") == (0x6077, 0)
    assert [profile_name(text) for text in ("My Drive_2", "--", "epos4")] == ["my-drive-2", "drive", "epos4"]


def test_a_profile_beside_the_cell_is_found_with_and_without_its_suffix(tmp_path, device):
    text = draft(device(), ProfileAnswers(), "mine")
    (tmp_path / "mine.toml").write_text(text)
    assert find_profile("mine", tmp_path).text == find_profile("mine.toml", tmp_path).text == text
    assert find_profile("maxon-epos4", tmp_path).name == "maxon-epos4"
