"""CANopen drives on a CAN bus (CiA 301, CiA 402), independent of the robot."""

from drives.lean_can import keep_lean

keep_lean()
