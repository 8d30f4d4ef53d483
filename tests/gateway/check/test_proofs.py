"""What a proof that the drives stop stands for, and what makes it void."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from drives.objects import OBJECTS
from drives.profile_file import load_profile, parse_profile
from drives.values import Identity
from gateway.cell.config import load_cell
from gateway.check.proofs import first_motion_pending, keep_proof, note_motion, proven_on
from gateway.preflight.drive_check import addresses

LOADED = load_cell(Path(__file__).parents[3] / "examples" / "small" / "cell.toml")
PROFILE = load_profile("generic-cia402")
IDENTITY = Identity(1, 0x00020192, 2, 7, 0x10000, 5, "drive", "1", "2.3")
PASSED = SimpleNamespace(passed=True, as_json=dict, override=1.0)
FAILED = SimpleNamespace(passed=False, as_json=dict)


def opened(**changes):
    """Six drives that were read; `changes` are of the third one, or of the SYNC."""
    axes = list(LOADED.cell.arm[0].axis)
    identities = [replace(IDENTITY, node_id=node, serial_number=100 + node) for node in range(1, 7)]
    profiles = [PROFILE] * 6
    readings = [{address: 1000 + address[0] % 97 for address in addresses(PROFILE)} for _ in range(6)]
    axes[2] = axes[2].model_copy(update=changes.get("axis", {}))
    identities[2] = replace(identities[2], **changes.get("identity", {}))
    profiles[2] = changes.get("profile", PROFILE)
    readings[2] |= {OBJECTS[name].address: value for name, value in changes.get("read", {}).items()}
    return SimpleNamespace(
        config=LOADED.cell.arm[0].model_copy(update={"axis": tuple(axes)}),
        identities=tuple(identities),
        profiles=tuple(profiles),
        readings=tuple(readings),
        session=changes.get("session", ""),
        group=SimpleNamespace(
            timing=SimpleNamespace(pacing=changes.get("pacing", "real"), period_s=changes.get("period_s", 0.004))
        ),
    )


def profile(old, new):
    assert old in PROFILE.text
    return parse_profile(PROFILE.text.replace(old, new, 1), "p.toml")


@pytest.fixture
def path(tmp_path):
    return tmp_path / "proof.json"


SETTINGS = [
    "abort_connection_option",
    "quick_stop_option",
    "shutdown_option",
    "disable_operation_option",
    "halt_option",
    "fault_reaction_option",
    "following_error_window",
    "following_error_timeout",
    "max_profile_velocity",
    "max_motor_speed",
    "supported_modes",
    "consumer_heartbeat",
    "max_torque",
    "max_current",
    "positive_torque_limit",
    "negative_torque_limit",
    "rated_current",
    "rated_torque",
    "position_range_min",
    "position_range_max",
    "home_offset",
    "position_limit_min",
    "position_limit_max",
    "polarity",
    "profile_deceleration",
    "quick_stop_deceleration",
    "encoder_increments",
    "encoder_revolutions",
    "gear_motor_revolutions",
    "gear_shaft_revolutions",
    "feed_constant_feed",
    "feed_constant_revolutions",
    "position_offset",
]


@pytest.mark.parametrize("name", SETTINGS)
@pytest.mark.parametrize("value", [7, None])
def test_any_setting_of_a_drive_that_changes_makes_the_proof_void(path, name, value):
    keep_proof(path, opened(), PASSED)
    assert proven_on(path, opened())
    assert proven_on(path, opened(read={name: value})) is None


@pytest.mark.parametrize(
    "changes",
    [
        {"pacing": "lockstep"},
        {"period_s": 0.01},
        {"identity": {"serial_number": 9}},
        {"identity": {"software_version": "2.4"}},
        {"identity": {"product_code": 8}},
        {"axis": {"position_sign": -1}},
        {"axis": {"torque_sign": -1}},
        {"axis": {"gear_ratio": LOADED.cell.arm[0].axis[2].gear_ratio.model_copy(update={"value": 33.0})}},
        {"profile": profile("consumer_ms = 500", "consumer_ms = 400")},
        {"profile": profile("abort_connection = 3", "abort_connection = 2")},
    ],
)
def test_sync_drive_gear_and_watchdog_belong_to_the_proof(path, changes):
    keep_proof(path, opened(), PASSED)
    assert proven_on(path, opened(**changes)) is None


@pytest.mark.parametrize("serial", [None, 0, 0xFFFFFFFF, 101], ids=["none", "0", "unset", "that of another drive"])
def test_without_a_serial_number_of_its_own_a_drive_is_proven_in_each_session(path, serial):
    missing = {"identity": {"serial_number": serial}}
    keep_proof(path, opened(**missing, session="a"), PASSED)
    assert proven_on(path, opened(**missing, session="a"))
    assert proven_on(path, opened(**missing, session="b")) is None
    keep_proof(path, opened(session="a"), PASSED)
    assert proven_on(path, opened(session="b"))


@pytest.mark.parametrize("name", ["statusword", "position", "digital_inputs", "torque_offset", "torque"])
def test_what_changes_by_itself_does_not(path, name):
    keep_proof(path, opened(), PASSED)
    assert proven_on(path, opened(read={name: 7}))


def test_a_failed_proof_removes_what_was_kept(path):
    keep_proof(path, opened(), PASSED)
    keep_proof(path, opened(), FAILED)
    assert not path.exists()
    assert proven_on(path, opened()) is None


@pytest.mark.parametrize("text", ["", "[]", "{"])
def test_a_file_that_is_no_proof_is_ignored(path, text):
    path.write_text(text)
    assert proven_on(path, opened()) is None
    assert first_motion_pending(path, opened())


def test_a_proof_that_was_edited_is_ignored(path):
    keep_proof(path, opened(), PASSED)
    body = json.loads(path.read_text())
    path.write_text(json.dumps(body | {"override": 2.0}))
    assert proven_on(path, opened()) is None


def test_the_first_motion_is_pending_until_it_is_noted_and_again_after_a_change(path):
    assert first_motion_pending(path, opened())
    note_motion(path, opened())
    assert not path.exists(), "no proof, nothing to note it in"
    keep_proof(path, opened(), PASSED)
    assert first_motion_pending(path, opened())
    note_motion(path, opened())
    assert not first_motion_pending(path, opened())
    date = proven_on(path, opened())
    keep_proof(path, opened(), PASSED)
    assert not first_motion_pending(path, opened()), "proving again takes nothing back"
    assert date is not None
    assert first_motion_pending(path, opened(read={"max_torque": 7}))
    keep_proof(path, opened(read={"max_torque": 7}), PASSED)
    assert first_motion_pending(path, opened(read={"max_torque": 7}))
