"""Compute velocity and torque offsets along a path from the arm's model and the identified load; pure functions, no
bus.

The torque controller receives the rigid-body model (CiA 402-2, 0x60B2): gravity, inertia, Coriolis and centrifugal
torque, rotor inertia, friction and gear losses. The velocity controller receives the rest of the velocity (0x60B1).
Equations (7) and (8) of JP3698770B2 are the special case of one vertical axis.
"""
