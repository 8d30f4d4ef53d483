"""Simulated drives and arms."""

from drives.lean_can import keep_lean

keep_lean()
