"""Simulated CANopen servo drives and robot arms, as test objects for the gateway."""

from drives.lean_can import keep_lean

keep_lean()
