"""Proofs that the drives stop on loss of the master, kept beside the write ledger and asked for before anything moves.

A proof stands for these six drives (serial number, firmware) with these settings.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from gateway.check.preflight import require_passed
from gateway.check.stop import StopProof, prove_stop
from gateway.motion.opening import OpenArm

SCHEMA: Final = 1


def fingerprint(opened: OpenArm) -> list[dict[str, Any]]:
    """What a proof stands for: the six drives and what they were told to do."""
    return [
        {
            "node_id": identity.node_id,
            "vendor_id": identity.vendor_id,
            "product_code": identity.product_code,
            "serial_number": identity.serial_number,
            "firmware": identity.software_version,
            "consumer_ms": profile.heartbeat.consumer_ms,
            "abort_connection": profile.heartbeat.abort_connection,
        }
        for identity, profile in zip(opened.identities, opened.profiles, strict=True)
    ]


def proven_on(path: Path, opened: OpenArm) -> str | None:
    """Date of a proof for these drives with these settings; None = there is none."""
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if not isinstance(stored, dict) or stored.get("schema") != SCHEMA or stored.get("drives") != fingerprint(opened):
        return None
    return str(stored.get("date"))


def keep_proof(path: Path, opened: OpenArm, proof: StopProof) -> None:
    """Keep a proof that was passed; one that failed removes what was kept."""
    if not proof.passed:
        path.unlink(missing_ok=True)
        return
    date = datetime.now(UTC).isoformat(timespec="seconds")
    body = {"schema": SCHEMA, "date": date, "drives": fingerprint(opened), "seen": proof.as_json()}
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    temporary.write_text(json.dumps(body, indent=1) + "\n", encoding="utf-8")
    os.replace(temporary, path)


def ensure_proven(opened: OpenArm, path: Path, say: Callable[[str], None]) -> None:
    """Make sure that loss of the master stops these drives, before anything else moves; proven once, then kept.

    Parameters
    ----------
    opened : OpenArm
        Connected and configured, in its brakes; the person has agreed that it moves.
    path : Path
        Where the proof is kept.
    say : callable
        Takes a remark.

    Raises
    ------
    FindingFailed
        A drive does not stop.
    PlanRefused, DriveError, KeyboardInterrupt
        As `prove_stop`.
    """
    date = proven_on(path, opened)
    if date is not None:
        say(f"drives stop on loss of the master: proven {date}")
        return
    say("proving that the drives stop on loss of the master: a slow motion without heartbeat")
    proof = prove_stop(opened)
    keep_proof(path, opened, proof)
    require_passed(proof.items, "nothing is measured")
    say(f"every drive stopped by itself, within {1000 * max(trace.left_s or 0.0 for trace in proof.traces):.0f} ms")
