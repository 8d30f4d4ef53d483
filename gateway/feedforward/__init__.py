"""Velocity and torque offsets of a path from the arm's model and the identified load: pure, no bus.

The torque loop receives the rigid-body model (CiA 402-2, 0x60B2): gravity, inertia, Coriolis and centrifugal torque,
rotor inertia, friction and gear losses. The velocity loop receives the rest of the velocity (0x60B1). Equations (7)
and (8) of JP3698770B2 are the case of one vertical axis.
"""
