"""Velocity and torque offsets of a path from the arm's model and the identified load: pure, no bus.

The whole rigid-body model (gravity, inertia, Coriolis and centrifugal torque, rotor inertia, friction, gear losses)
goes to the torque loop (CiA 402-2, 0x60B2); what the drive's own velocity feedforward leaves goes to the velocity loop
(0x60B1). JP3698770B2 equations (7) and (8) are the case of one vertical axis.
"""
