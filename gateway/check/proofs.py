"""Proofs that the drives stop on loss of the master, stored beside the write ledger and required before any motion.

A proof is valid for these drives (serial number, firmware) with these settings, SYNC and gears, and up to the speed
override at which it was made. Any change makes it invalid, together with the record that these drives have moved
before. The exchange of a drive without a serial number cannot be detected: its proof is valid only in the session in
which it was made.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from drives.files import read_sealed, write_sealed
from drives.ledger import KnownDevice, without_shared_serials
from gateway.check.stop import StopProof, prove_stop
from gateway.errors import FindingFailed
from gateway.motion.opening import OpenArm
from gateway.motion.stream import MoveOptions
from gateway.preflight.drive_check import live_addresses, require_passed

SCHEMA: Final = 4


def fingerprint(opened: OpenArm) -> dict[str, Any]:
    """Return the fingerprint of a proof: SYNC, and for each axis the drive, its settings, gear and commands."""
    timing, axes = opened.group.timing, list[dict[str, Any]]()
    drives = zip(
        opened.config.axis, opened.profiles, opened.identities, opened.readings, _serial_numbers(opened), strict=True
    )
    for config, profile, identity, readings, serial in drives:
        live = live_addresses(profile)
        kept = sorted((address, value) for address, value in readings.items() if address not in live)
        axes.append(
            {
                "node_id": identity.node_id,
                "vendor_id": identity.vendor_id,
                "product_code": identity.product_code,
                "revision": identity.revision,
                "firmware": identity.software_version,
                "heartbeat": profile.heartbeat.model_dump(),
                "cyclic_mode": profile.state_machine.cyclic_mode,
                "gear_ratio": config.gear_ratio.value,
                "position_sign": config.position_sign,
                "torque_sign": config.torque_sign,
                "settings": {f"{index:04X}:{subindex:02X}": value for (index, subindex), value in kept},
                "serial_number": f"none; session {opened.session}" if serial is None else serial,
            }
        )
    return {"pacing": timing.pacing, "sync_period_s": timing.period_s, "axes": axes}


def _serial_numbers(opened: OpenArm) -> list[int | None]:
    """Return the serial number of each drive; None where it has none, or shares it with another one."""
    devices = [KnownDevice.of(identity, None) for identity in opened.identities]
    return [device.serial_number for device in without_shared_serials(devices)]


def proven_on(path: Path, opened: OpenArm, override: float = 1.0) -> str | None:
    """Return the date of a proof for these drives with these settings at this speed override; None without a proof."""
    stored = _stored(path, opened)
    return None if stored is None or not stored["override"] >= override else str(stored["date"])


def first_motion_pending(path: Path, opened: OpenArm) -> bool:
    """Return True if these drives with these settings have not completed a motion yet.

    Parameters
    ----------
    path : Path
        File of the proof.
    opened : OpenArm
    """
    stored = _stored(path, opened)
    return stored is None or stored.get("moved") is not True


def note_motion(path: Path, opened: OpenArm) -> None:
    """Note that a first motion with these drives was completed; without a valid proof nothing is noted.

    Parameters
    ----------
    path : Path
        File of the proof.
    opened : OpenArm
    """
    stored = _stored(path, opened)
    if stored is not None and stored.get("moved") is not True:
        write_sealed(path, stored | {"moved": True})


def keep_proof(path: Path, opened: OpenArm, proof: StopProof) -> None:
    """Store a passed proof, unless a valid one at a larger override is stored; a failed one removes the stored one."""
    if not proof.passed:
        path.unlink(missing_ok=True)
        return
    stored = _stored(path, opened)
    if stored is not None and stored["override"] > proof.override:
        return
    date = datetime.now(UTC).isoformat(timespec="seconds")
    moved = stored is not None and stored.get("moved") is True
    write_sealed(
        path,
        {
            "schema": SCHEMA,
            "date": date,
            "drives": fingerprint(opened),
            "override": proof.override,
            "moved": moved,
            "seen": proof.as_json(),
        },
    )


def _stored(path: Path, opened: OpenArm) -> dict[str, Any] | None:
    """Return the stored proof, if it is valid for these drives."""
    try:
        stored = read_sealed(path)
    except (OSError, ValueError):
        return None
    return stored if (stored["schema"], stored["drives"]) == (SCHEMA, fingerprint(opened)) else None


def prove_now(opened: OpenArm, path: Path, say: Callable[[str], None], options: MoveOptions) -> None:
    """Prove that loss of the master stops these drives, and store the proof.

    Parameters
    ----------
    opened : OpenArm
        Connected and configured, brakes on; the operator has agreed that it moves.
    path : Path
        File of the proof.
    say : callable
        Shows a remark to the operator.
    options : MoveOptions

    Raises
    ------
    FindingFailed
        A drive does not stop.
    PlanRefused, DriveError, KeyboardInterrupt
        As `prove_stop`.
    """
    say("testing that the drives stop on loss of the master: a slow motion without heartbeat")
    proof = prove_stop(opened, options)
    keep_proof(path, opened, proof)
    require_passed(proof.items, "nothing is measured")
    say(f"every drive stopped by itself, within {1000 * max(trace.left_s or 0.0 for trace in proof.traces):.0f} ms")


def require_proven(opened: OpenArm, path: Path, override: float) -> None:
    """Require a valid proof for a speed override where none can be made because two arms hold one part.

    Raises
    ------
    FindingFailed
        There is no proof for these drives with these settings.
    """
    unknown = [f"J{joint}" for joint, serial in enumerate(_serial_numbers(opened), start=1) if serial is None]
    if unknown:
        raise FindingFailed(
            f"the arm is not moved: arm '{opened.config.name}', {', '.join(unknown)}: a drive without a serial number"
            " has to be proven to stop in each session, which is not possible while two arms hold a part; use"
            " drives with serial numbers (0x1018:04)"
        )
    if proven_on(path, opened, override) is None:
        raise FindingFailed(
            f"the arm is not moved: it is not proven that the drives of arm '{opened.config.name}', with their present"
            f" settings, stop on loss of the master at {override:.0%} of the speed; open both grippers, then:"
            f" servo-gateway check CELL --prove-stop --override {100 * override:.0f}"
        )
