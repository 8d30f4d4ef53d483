"""Proofs that the drives stop on loss of the master, kept beside the write ledger and asked for before anything moves.

A proof stands for these drives (serial number, firmware), as they are set up, under this SYNC, behind these gears.
What changes any of it makes the proof void, and with it the knowledge that these drives have moved before.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from drives.files import replace_file
from drives.profile import DriveProfile
from drives.values import Identity
from gateway.cell.config import AxisConfig
from gateway.check.stop import StopProof, prove_stop
from gateway.errors import FindingFailed
from gateway.motion.holdtorun import with_held_input
from gateway.motion.opening import OpenArm
from gateway.motion.stream import MoveOptions
from gateway.preflight.drive_check import live_addresses, require_passed
from gateway.preflight.rules import Readings

SCHEMA: Final = 2


def fingerprint(opened: OpenArm) -> dict[str, Any]:
    """What a proof stands for: SYNC, and of each axis drive, settings, gear and the commands of the drive."""
    timing = opened.group.timing
    axes = zip(opened.config.axis, opened.profiles, opened.identities, opened.readings, strict=True)
    return {
        "pacing": timing.pacing,
        "sync_period_s": timing.period_s,
        "axes": [
            _axis(config, profile, identity, _settings(profile, readings))
            for config, profile, identity, readings in axes
        ],
    }


def _axis(
    config: AxisConfig, profile: DriveProfile, identity: Identity, settings: Mapping[str, int | None]
) -> dict[str, Any]:
    return {
        "node_id": identity.node_id,
        "vendor_id": identity.vendor_id,
        "product_code": identity.product_code,
        "revision": identity.revision,
        "serial_number": identity.serial_number,
        "firmware": identity.software_version,
        "consumer_ms": profile.heartbeat.consumer_ms,
        "abort_connection": profile.heartbeat.abort_connection,
        "gear_ratio": config.gear_ratio.value,
        "position_sign": config.position_sign,
        "torque_sign": config.torque_sign,
        "settings": dict(settings),
    }


def _settings(profile: DriveProfile, readings: Readings) -> dict[str, int | None]:
    live = live_addresses(profile)
    kept = sorted((address, value) for address, value in readings.items() if address not in live)
    return {f"{index:04X}:{subindex:02X}": value for (index, subindex), value in kept}


def proven_on(path: Path, opened: OpenArm) -> str | None:
    """Date of a proof for these drives with these settings; None = there is none."""
    stored = _stored(path, opened)
    return None if stored is None else str(stored.get("date"))


def first_motion_pending(path: Path, opened: OpenArm) -> bool:
    """Whether no motion with these drives, as they are set up, was completed yet.

    Parameters
    ----------
    path : Path
        Where the proof is kept.
    opened : OpenArm
    """
    stored = _stored(path, opened)
    return stored is None or stored.get("moved") is not True


def note_motion(path: Path, opened: OpenArm) -> None:
    """A first motion with these drives was completed; nothing is noted where no proof stands for them.

    Parameters
    ----------
    path : Path
        Where the proof is kept.
    opened : OpenArm
    """
    stored = _stored(path, opened)
    if stored is not None and stored.get("moved") is not True:
        _write(path, stored | {"moved": True})


def keep_proof(path: Path, opened: OpenArm, proof: StopProof) -> None:
    """Keep a proof that was passed; one that failed removes what was kept."""
    if not proof.passed:
        path.unlink(missing_ok=True)
        return
    date = datetime.now(UTC).isoformat(timespec="seconds")
    moved = not first_motion_pending(path, opened)
    body = {"schema": SCHEMA, "date": date, "drives": fingerprint(opened), "moved": moved, "seen": proof.as_json()}
    _write(path, body)


def _stored(path: Path, opened: OpenArm) -> dict[str, Any] | None:
    """The proof that is kept, if it stands for these drives."""
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if not isinstance(stored, dict) or stored.get("schema") != SCHEMA or stored.get("drives") != fingerprint(opened):
        return None
    return stored


def _write(path: Path, body: Mapping[str, Any]) -> None:
    replace_file(path, json.dumps(body, indent=1) + "\n")


def ensure_proven(opened: OpenArm, path: Path, say: Callable[[str], None], options: MoveOptions) -> MoveOptions:
    """Make sure that loss of the master stops these drives, before anything else moves; proven once, then kept.

    Parameters
    ----------
    opened : OpenArm
        Connected and configured, in its brakes; the person has agreed that it moves.
    path : Path
        Where the proof is kept.
    say : callable
        Takes a remark.
    options : MoveOptions

    Returns
    -------
    MoveOptions
        For what moves next: the first motion of all with these drives goes slowly.

    Raises
    ------
    FindingFailed
        A drive does not stop.
    PlanRefused, DriveError, KeyboardInterrupt
        As `prove_stop`.
    """
    options = with_held_input(opened, options)
    date = proven_on(path, opened)
    if date is not None:
        say(f"drives stop on loss of the master: proven {date}")
        return slow_at_first(opened, path, options)
    say("proving that the drives stop on loss of the master: a slow motion without heartbeat")
    proof = prove_stop(opened, options)
    keep_proof(path, opened, proof)
    require_passed(proof.items, "nothing is measured")
    say(f"every drive stopped by itself, within {1000 * max(trace.left_s or 0.0 for trace in proof.traces):.0f} ms")
    return slow_at_first(opened, path, options)


def slow_at_first(opened: OpenArm, path: Path, options: MoveOptions) -> MoveOptions:
    """The same options; where nothing has moved yet with these drives, the first motion goes slowly and is noted."""
    if not first_motion_pending(path, opened):
        return options
    return replace(options, first_done=lambda: note_motion(path, opened))


def require_proven(opened: OpenArm, path: Path) -> None:
    """Require a valid proof where none can be made now: two arms hold one part.

    Raises
    ------
    FindingFailed
        There is none for these drives with these settings.
    """
    if proven_on(path, opened) is None:
        raise FindingFailed(
            f"nothing has moved: it is not proven that the drives of arm '{opened.config.name}', as they are set up, "
            "stop when the master is gone; open both grippers, then: servo-gateway check CELL --prove-stop"
        )
