"""Drives on a CAN bus: CANopen (CiA 301) and CiA 402, nothing of robots."""

from drives.lean_can import keep_lean

keep_lean()
