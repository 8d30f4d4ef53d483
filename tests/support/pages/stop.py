"""A black box of a run that a fault has stopped: what every part of its page is made of, without a run."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from drives.frame_log import FRAME, RECEIVED
from gateway.data.blackbox.box import BlackBox, read_box, write_box
from gateway.data.blackbox.part import FIELDS, HEAD, BoxHeader, pack, unpack, width_of
from gateway.data.blackbox.ring_buffer import box_of

ROOT = Path(__file__).parents[3]
CELL = (ROOT / "examples/small/cell.toml").read_text(encoding="utf-8")
PERIOD_S, SYNCS, AXES = 0.01, 400, 6
#: The run goes by its own time: by the wall clock it takes twice as long.
WALL_S, SLOW = 1.7e9, 2.0
ENABLED, FAULT, DISABLED = 0x1237, 0x1218, 0x1250
FAULTED, UNRESPONSIVE = 4, 5
REASON = "node 4: it failed"


def word(value: int) -> bytes:
    return value.to_bytes(2, "little") + bytes(6)


def frames() -> bytes:
    """Answers to every SYNC and three more; node 4 fails at the stop, node 5 does not respond from 1 s before it."""
    end_s = WALL_S + SLOW * PERIOD_S * (SYNCS - 1)
    sent: list[tuple[float, int, int, bytes]] = []
    for sync in range(SYNCS + 3):
        after = sync - (SYNCS - 1)
        at_s = end_s + PERIOD_S * after * (SLOW if after < 0 else 1.0)
        sent.append((at_s, 0x80, 0, b""))
        for node in range(1, AXES + 1):
            if node == UNRESPONSIVE and sync > SYNCS - 1 - 100:
                continue
            over = DISABLED if sync >= SYNCS else ENABLED
            sent.append((at_s, 0x180 + node, RECEIVED, word(FAULT if node == FAULTED and sync >= SYNCS else over)))
            sent.append((at_s, 0x200 + node, 0, word(0x0F if sync < SYNCS else 0)))
    sent += [
        (end_s - 1.0, 0x600 + 2, 0, bytes.fromhex("4041600000000000")),
        (end_s - 0.99, 0x580 + 2, RECEIVED, bytes.fromhex("4b41600037120000")),
        (end_s - 0.5, 0x580 + 3, RECEIVED, bytes.fromhex("8041600000000206")),
        (end_s + 0.004, 0x80 + FAULTED, RECEIVED, bytes.fromhex("0573200000000000")),
        (end_s + 0.02, 0x000, 0, bytes([0x81, 6])),
        (end_s + 0.03, 0x700 + 6, RECEIVED, b"\0"),
    ]
    return b"".join(FRAME.pack(at, can_id, flags, len(data), data) for at, can_id, flags, data in sent)


def values() -> dict[str, np.ndarray]:
    """Samples (n, N): J1 turns at 0.5 rad/s and lags its command by 2 mrad; J2 lacks 10 SYNCs."""
    now = PERIOD_S * np.arange(SYNCS)
    found = {name: np.zeros((SYNCS, AXES)) for name, _ in FIELDS}
    found["q_rad"][:, 0] = 0.5 * now
    found["target_rad"][:, 0] = 0.5 * (now + PERIOD_S) + 0.002
    found["joint_torque_nm"][:, 0] = 3.0
    found["modelled_torque_nm"][:, 0] = 1.0
    found["q_rad"][200:210, 1] = np.nan
    return found


def stopped(folder: Path, cell: str = CELL) -> BlackBox:
    """The box, on disk and read again."""
    recording = folder / "run.h5"
    held = values()
    head = np.column_stack([WALL_S + SLOW * PERIOD_S * np.arange(SYNCS), PERIOD_S * np.arange(SYNCS), range(SYNCS)])
    rows = np.concatenate([head, *(held[name] for name, _ in FIELDS)], axis=1)
    assert rows.shape[1] == width_of(AXES) == len(HEAD) + AXES * len(FIELDS)
    part = unpack(pack(rows, frames(), 4.0, WALL_S))
    write_box(box_of(recording), BoxHeader(recording, (("main", AXES),), cell, "now", "test"), [part], REASON)
    return read_box(box_of(recording))
