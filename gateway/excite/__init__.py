"""Excitation trajectories to identify an arm and its load: periodic series of all joints, sweeps of one joint."""
