"""Drive profiles: every packaged one, every mistake in a file, the arithmetic by formula."""

from __future__ import annotations

import json
import math
import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drives.discovery import matching_profiles
from drives.errors import ProfileError
from drives.profile_file import PROFILE_FOLDER, list_profiles, load_profile, parse_profile, profile_schema
from drives.scaling import Constants, motor_scale
from drives.toml_text import parse_toml
from drives.values import AxisSetup, Identity

GENERIC = (PROFILE_FOLDER / "generic-cia402.toml").read_text()


@pytest.mark.parametrize("name", list_profiles())
def test_every_profile_loads_and_is_named_as_its_file(name):
    profile = load_profile(name)
    assert profile.name == name
    assert profile.text == (PROFILE_FOLDER / f"{name}.toml").read_text()
    assert load_profile(PROFILE_FOLDER / f"{name}.toml") == profile
    assert profile.obstacles or profile.torque.nature == "measured"
    assert profile.obstacles or profile.torque.basis in ("standard", "manual", "measured", "code")


def test_every_kind_of_torque_arithmetic_is_there():
    found = {(profile.torque.kind, profile.torque.object.index) for profile in map(load_profile, list_profiles())}
    assert ("permille_rated_torque", 0x6077) in found
    assert ("permille_rated_current", 0x6077) in found
    assert ("internal_unit", 0x6077) in found
    assert ("internal_unit", 0x6078) in found
    rated = [profile.torque.rated for profile in map(load_profile, list_profiles())]
    assert any(each is not None and each.value is not None for each in rated)


def test_the_makes_that_are_asked_for_are_there_and_no_drive_of_another_fieldbus():
    makes = {name.split("-")[0] for name in list_profiles()}
    wanted = "copley delta elmo festo igus kinco kollmorgen leadshine maxon nanotec novanta pilz schneider schunk"
    assert {*wanted.split(), "technosoft", "trinamic", "zeroerr"} <= makes
    assert "beckhoff" not in makes


@pytest.mark.parametrize("name", list_profiles())
def test_no_profile_may_store_or_restore(name):
    assert not {0x1010, 0x1011} & set(load_profile(name).write.allow)


def remove(text, start):
    """Text without the line that starts with `start`."""
    lines = [line for line in text.splitlines() if not line.startswith(start)]
    assert len(lines) < len(text.splitlines())
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("name = ", "not valid TOML"),
        (GENERIC + "\n[unknown]\nx = 1", r"mine.toml line .*: unknown: unknown key"),
        (GENERIC.replace("filter_s = 0.001", "filter_ms = 1", 1), r"\[torque\]: filter_ms: unknown key"),
        (remove(GENERIC, "unit = 0.001"), "unit belong together"),
        (remove(GENERIC, "nature"), r"\[torque\], \[current\]: nature is missing"),
        (remove(GENERIC, "current_reference"), "current_reference and torque_constant_per"),
        (remove(GENERIC, "transition_timeout_s"), "transition_timeout_s is missing"),
        (GENERIC + '[[emcy]]\ncode = 0\ntext = "x"\nadvice = "x"\n', "0x0000 is listed twice or is no error"),
        (
            GENERIC.replace('source = "CiA 402-2, 0x6076 in mNm"', 'source = ""'),
            "source = .* is too short",
        ),
        (GENERIC.replace("unit = 0.001", "unit = 0.0", 1), r"\[torque.rated\]: unit = 0.0 must be more than 0"),
        (GENERIC.replace("unit = 0.001", "unit = nan", 1), r"\[torque.rated\]: unit = NaN is not a finite number"),
        (GENERIC.replace("0x6007, 0x6040", "0x1010, 0x6007, 0x6040"), "storing parameters"),
        (GENERIC.replace("0x6007, 0x6040", "0x6040"), "allow lacks 0x6007"),
        (GENERIC.replace("0x1801, ", ""), "second TPDO"),
        (GENERIC.replace("0x1016, 0x1017", "0x1016"), "producer_ms needs 0x1017"),
        (GENERIC.replace('type = "i16"', 'type = "u16"', 1), "does not fit the object type"),
        (GENERIC.replace('type = "i16"', 'type = "i24"', 1), "object: type = .i24. is not an allowed"),
        (GENERIC.replace('name = "generic-cia402"', 'name = "../x"'), "name"),
        (GENERIC.replace("abort_connection = 3", "abort_connection = 0"), "abort_connection"),
        (GENERIC.replace("[state_machine]", "[state_machine]\nignored_status = 0x006F"), "ignored_status"),
        (GENERIC.replace("[heartbeat]", '[heartbeat]\nwatchdog = "node guarding"'), "node guarding"),
        (GENERIC.replace("slow_timeout_s = 2.0", "slow_timeout_s = 0.1"), "slow_timeout_s"),
        (GENERIC[: GENERIC.index("[torque.rated]")] + GENERIC[GENERIC.index("[current]") :], "the value that 1000 per"),
        (GENERIC.replace('"permille_rated_torque"', '"internal_unit"', 1), "internal_unit_a belongs to kind"),
        (
            GENERIC.replace("[torque]", '[torque]\ninternal_unit_a = { value = 1.0, source = "x" }', 1),
            "internal_unit_a belongs to kind",
        ),
        (GENERIC.replace('kind = "permille_rated_current"', 'kind = "permille_rated_torque"'), "is not a current"),
        (
            GENERIC.replace('index = 0x6064, subindex = 0, type = "i32"', 'index = 0x6064, subindex = 0, type = "i16"'),
            "i32",
        ),
        (
            GENERIC[: GENERIC.index("[velocity]")] + GENERIC[GENERIC.index("[position]") :],
            r"feedforward needs \[velocity\]",
        ),
        (
            GENERIC + '[torque_offset]\nkind = "permille_rated_current"\nrated = { value = 1.0, source = "x" }\n'
            'current_reference = "rms"\nsource = "x"\n',
            "current_reference and torque_constant_per",
        ),
    ],
)
def test_a_mistake_is_named_with_file_and_key(text, says):
    with pytest.raises(ProfileError, match=says) as caught:
        parse_profile(text, "mine.toml")
    assert "mine.toml" in str(caught.value)
    assert caught.value.exit_code == 3


def test_every_mistake_of_a_file_is_named_at_once():
    text = remove(remove(GENERIC, "nature"), "signed")
    with pytest.raises(ProfileError, match=r"\[torque\], \[current\]: nature is.*\[torque\], \[current\]: signed"):
        parse_profile(text, "mine.toml")


def test_a_profile_that_is_not_there_names_those_that_are():
    with pytest.raises(ProfileError, match="generic-cia402"):
        load_profile("unknown")


def test_the_schema_is_json_and_has_every_key():
    schema = json.loads(json.dumps(profile_schema()))
    assert set(tomllib.loads(GENERIC)) <= set(schema["properties"])


@pytest.mark.slow
@given(st.text(max_size=200))
def test_any_text_is_a_profile_or_a_profile_error(text):
    with pytest.raises(ProfileError):
        parse_profile(text, "x")


# -- arithmetic, by the formulas of the profiles' sources ---------------------------------------------------------


def constants(**given_here):
    values = {"torque_rated": None, "current_rated_a": None, "offset_rated": None, "counts_per_revolution": 65536.0}
    return Constants(**(values | given_here))


def test_per_mille_of_the_rated_torque():
    """CiA 402-2, 0x6077: M = raw / 1000 x 0x6076; the torque constant plays no part."""
    for kt in (0.1, 7.0):
        scale = motor_scale(load_profile("generic-cia402"), constants(torque_rated=2.4, current_rated_a=5.0), kt)
        assert 500 * scale.torque_nm == pytest.approx(0.5 * 2.4)
        assert 500 * scale.current_a == pytest.approx(0.5 * 5.0)
        assert 500 * scale.offset_nm == pytest.approx(0.5 * 2.4)


def packaged(name, *changes):
    """A packaged profile with changes of its text, as an engineer makes them in a copy."""
    text = (PROFILE_FOLDER / f"{name}.toml").read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    return parse_profile(text, name)


@pytest.mark.parametrize(("reference", "rms_a"), [("rms", 4.0), ("peak", 4.0 / math.sqrt(2))])
def test_per_mille_of_the_rated_current_with_peak_and_rms(reference, rms_a):
    """Nanotec 6077h: 500 is half of the torque at 203Bh:01. Whose ampere that is, an engineer has to find out."""
    with pytest.raises(ProfileError, match="rms or peak is not known"):
        motor_scale(load_profile("nanotec"), constants(torque_rated=4.0), 0.3)
    answer = ('basis = "assumed"', f'basis = "measured"\ncurrent_reference = "{reference}"')
    profile = packaged("nanotec", answer)
    assert profile.obstacles == ()
    scale = motor_scale(profile, constants(torque_rated=4.0), 0.3)
    assert 500 * scale.torque_nm == pytest.approx(0.5 * rms_a * 0.3)


def test_milliampere():
    old = GENERIC[GENERIC.index("[torque]") : GENERIC.index("[current]")]
    new = """[torque]
kind = "milliampere"
object = { index = 0x30D1, subindex = 2, type = "i32" }
nature = "measured"
signed = true
filter_s = 0.001
source = "manual"
current_reference = "peak"
torque_constant_per = "peak"

[torque_offset]
kind = "permille_rated_torque"
rated = { object = { index = 0x6076, subindex = 0, type = "u32" }, unit = 0.000001, source = "manual" }
source = "manual"

"""
    text = GENERIC.replace(old, new).replace('eds = "generic-cia402.eds"\n', "")
    given_here = constants(offset_rated=0.2, current_rated_a=1.0)
    scale = motor_scale(parse_profile(text, "x"), given_here, 0.05)
    assert 1500 * scale.torque_nm == pytest.approx(1.5 * 0.05)
    assert 100 * scale.offset_nm == pytest.approx(0.1 * 0.2)


def test_a_rated_torque_in_micro_newton_metres():
    """maxon EPOS4, DCF: 6.000 A at 34619 uNm/A are stored as 207714 in 0x6076."""
    profile = load_profile("maxon-epos4")
    rated_nm = 207714 * profile.torque.rated.unit
    assert rated_nm == pytest.approx(6.0 * 0.034619, rel=1e-5)
    scale = motor_scale(profile, constants(torque_rated=rated_nm), 1.0)
    assert 500 * scale.torque_nm == scale.offset_nm * 500 == pytest.approx(3.0 * 0.034619, rel=1e-5)


def test_firmware_without_csp_is_another_drive():
    """maxon EPOS4: 0x6502 is 0x225 at revision 0x0110 and 0x3A5 at 0x0170."""
    profile = load_profile("maxon-epos4")
    assert "below" in identity(vendor_id=0xFB, revision=0x01100000).mismatches(profile)[3]
    assert not identity(vendor_id=0xFB, revision=0x01700000).mismatches(profile)


def test_a_torque_whose_word_is_a_share_of_the_current():
    """Elmo MAN-CAN402IG p. 104: 2000 mA are 625 per mille where 0x6075 is 3200 mA; at 0.5 Nm/A 0x6076 is 1600 mNm."""
    profile = load_profile("elmo-gold")
    scale = motor_scale(profile, constants(torque_rated=1600 * profile.torque.rated.unit), 1.0)
    assert 625 * scale.torque_nm == pytest.approx(2.0 * 0.5)


def test_a_rated_current_that_is_a_peak_value():
    """Novanta EMCL: a motor of 2 A rms has 2828 in 0x6075."""
    profile = load_profile("novanta-emcl")
    rated_a = 2828 * profile.current.rated.unit
    scale = motor_scale(profile, constants(torque_rated=1.0, current_rated_a=rated_a), 0.3)
    assert 1000 * scale.current_a == pytest.approx(2.0, rel=1e-3)
    assert 250 * scale.torque_nm == pytest.approx(0.25)


def test_words_of_kinco():
    """FD5P manual p. 137, resolution 65536: 7E B1 E4 FF is -100 rpm, 6E A3 01 00 is 100 rps/s; 10 A rms of FD123."""
    profile = load_profile("kinco-fd123")
    scale = motor_scale(profile, constants(counts_per_revolution=65536.0), 0.132)
    word = int.from_bytes(bytes.fromhex("7EB1E4FF"), "little", signed=True)
    assert word * scale.velocity_rad_s == pytest.approx(-100 * 2 * math.pi / 60, rel=1e-6)
    ramp = int.from_bytes(bytes.fromhex("6EA30100"), "little")
    assert ramp * profile.velocity.ramp_rad_s2(65536.0) == pytest.approx(100 * 2 * math.pi, rel=1e-5)
    assert profile.velocity.ramp_rad_s2(None) is profile.velocity.rad_s(None) is None
    assert 10 * 1.414 * 2048 / 45 * scale.torque_nm == pytest.approx(10 * 0.132)
    assert scale.offset_nm is None


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("unit_counts_s = {", 'unit_rad_s = { value = 1.0, source = "x" }\nunit_counts_s = {'),
        ("unit_counts_s = { value = 0.06103515625, source", "# { value, source"),
    ],
)
def test_a_speed_has_one_unit(old, new):
    with pytest.raises(ProfileError, match="either unit_rad_s or unit_counts_s"):
        packaged("kinco-fd123", (old, new))


def test_a_ramp_counts_as_the_speed_does_unless_it_is_said_otherwise():
    velocity = load_profile("generic-cia402").velocity
    assert velocity.ramp_rad_s2(None) == velocity.rad_s(None) == velocity.unit_rad_s.value


def test_internal_units():
    """Technosoft iPOS: A = raw x 2 x I_peak / 65520; only zero may be sent as torque offset."""
    scale = motor_scale(load_profile("technosoft-ipos8010"), constants(), 0.05)
    assert 3276 * scale.torque_nm == pytest.approx(3276 * 2 * 20 / 65520 * 0.05)
    assert scale.offset_nm is None
    # 16.16 fixed point: 65536 is one increment of 8192 in a millisecond
    assert 65536 * scale.velocity_rad_s == pytest.approx(2 * math.pi / 8192 * 1000)


def test_internal_units_with_rms_and_peak_exchanged():
    text = (PROFILE_FOLDER / "technosoft-ipos8010.toml").read_text()
    text = text.replace('current_reference = "peak"', 'current_reference = "rms"')
    scale = motor_scale(parse_profile(text, "x"), constants(), 0.05)
    assert 1000 * scale.torque_nm == pytest.approx(1000 * 2 * 20 / 65520 * math.sqrt(2) * 0.05)


def test_per_mille_of_a_current_of_the_drive_and_not_of_the_motor():
    """Kollmorgen AKD: 1000 per mille = DRV.ICONT of the size of drive, 6 A rms; what 0x6075 says plays no part."""
    scale = motor_scale(load_profile("kollmorgen-akd-x00606"), constants(torque_rated=6.0), 0.4)
    assert 250 * scale.torque_nm == pytest.approx(0.25 * 6.0 * 0.4)
    assert 250 * scale.offset_nm == pytest.approx(0.25 * 6.0 * 0.4)


@pytest.mark.parametrize("reference", ["rms", "peak"])
@pytest.mark.parametrize("per", ["rms", "peak"])
def test_a_torque_offset_in_amperes_of_either_kind(reference, per):
    """A motor that gives 3 Nm at 2 A rms, which are 2 sqrt(2) A peak; 1000 per mille are 10 A rms."""
    peak = {"rms": 1.0, "peak": math.sqrt(2)}
    offset = f"""
[torque_offset]
kind = "permille_rated_current"
rated = {{ value = {10 * peak[reference]}, source = "plate" }}
current_reference = "{reference}"
torque_constant_per = "{per}"
source = "manual"
"""
    given_here = constants(torque_rated=2.4, current_rated_a=5.0, offset_rated=10 * peak[reference])
    scale = motor_scale(parse_profile(GENERIC + offset, "x"), given_here, 1.5 / peak[per])
    assert 200 * scale.offset_nm == pytest.approx(3.0)


def test_counts_and_velocity():
    scale = motor_scale(load_profile("generic-cia402"), constants(torque_rated=1.0, current_rated_a=1.0), 1.0)
    assert scale.counts(math.pi) == 32768
    assert 32768 * scale.count_rad == pytest.approx(math.pi)
    assert 100 * scale.velocity_rad_s == pytest.approx(2 * math.pi / 60)


@pytest.mark.parametrize("value", [None, 0.0, -1.0, math.nan, math.inf])
def test_a_missing_constant_is_an_error_and_never_one(value):
    for name, fields in (
        ("generic-cia402", {"torque_rated": value, "current_rated_a": 1.0}),
        ("generic-cia402", {"torque_rated": 1.0, "current_rated_a": value}),
        ("maxon-epos4", {"torque_rated": value}),
    ):
        with pytest.raises(ProfileError, match="positive number"):
            motor_scale(load_profile(name), constants(**fields), 1.0)
    with pytest.raises(ProfileError):
        motor_scale(load_profile("kinco-fd123"), constants(), value)


@pytest.mark.parametrize("kt", [0.0, -0.3, math.nan])
def test_a_setup_without_a_torque_constant_is_refused(kt):
    with pytest.raises(ProfileError, match="torque_constant"):
        AxisSetup(1, load_profile("generic-cia402"), kt, 100.0)


def identity(**given_here):
    values = {"vendor_id": 2, "product_code": 5, "revision": 0x20000}
    return Identity(
        1, 0x20192, **(values | given_here), serial_number=1, name="", hardware_version="", software_version=""
    )


def test_identity_is_compared_with_what_the_profile_gives():
    text = GENERIC.replace(
        "[torque]", "[identity]\nvendor_id = 2\nrevision_min = 0x10000\nrevision_max = 0x2ffff\n[torque]", 1
    )
    profile = parse_profile(text, "x")
    assert not identity().mismatches(profile)
    assert "vendor" in identity(vendor_id=3).mismatches(profile)[1]
    assert "below" in identity(revision=0x0FFFF).mismatches(profile)[3]
    assert "above" in identity(revision=0x30000).mismatches(profile)[3]
    assert len(identity(vendor_id=None, revision=None).mismatches(profile)) == 2


@pytest.mark.parametrize(
    ("wanted", "fits"),
    [
        ("", {None: True, 0x10000: True}),
        ("revision_min = 0x10000", {None: False, 0xFFFF: False, 0x10000: True, 0x90000: True}),
        ("revision_max = 0x20000", {None: False, 0: True, 0x20000: True, 0x20001: False}),
    ],
)
def test_a_revision_is_asked_for_by_either_bound_and_the_bounds_are_known_ones(wanted, fits):
    profile = parse_profile(GENERIC.replace("[torque]", f"[identity]\n{wanted}\n[torque]", 1), "x")
    assert {revision: not identity(revision=revision).mismatches(profile) for revision in fits} == fits


@pytest.mark.parametrize("node_id", [0, 128, -1])
def test_a_node_id_is_one_of_127(node_id):
    with pytest.raises(ProfileError, match=r"not in 1 \.\. 127"):
        AxisSetup(node_id, load_profile("generic-cia402"), 0.5, 100.0)
    assert [AxisSetup(node, load_profile("generic-cia402"), 0.5, 100.0).node_id for node in (1, 127)] == [1, 127]


@pytest.mark.parametrize(("parts", "fine"), [(63, True), (64, True), (65, False)])
def test_a_key_of_very_many_parts_is_refused(parts, fine):
    """The cost of the parser grows with their square."""
    text = ".".join("a" * parts) + " = 1"
    if fine:
        assert parse_toml(text)
    else:
        with pytest.raises(tomllib.TOMLDecodeError, match="more than 64 parts"):
            parse_toml(text)


@pytest.mark.parametrize("text", ["x = " + "9" * 5000, "x = " + "[" * 5000])
def test_what_the_interpreter_cannot_hold_is_no_toml(text):
    with pytest.raises(tomllib.TOMLDecodeError):
        parse_toml(text)


def test_a_drive_is_offered_the_profiles_of_its_vendor_and_the_generic_one_alone():
    """Profiles of makes whose vendor id is not known would fit every drive: they are named by an engineer."""
    assert matching_profiles(identity(vendor_id=0x9A)) == ("elmo-gold", "elmo-simpliq", "generic-cia402")
    assert matching_profiles(identity(vendor_id=0x7777)) == ("generic-cia402",)
    assert matching_profiles(identity(vendor_id=0xFB, revision=0x01100000)) == ("generic-cia402",)
