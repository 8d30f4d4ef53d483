"""Motions that are driven to learn an arm and its load: periodic series of all joints, sweeps of one joint."""
