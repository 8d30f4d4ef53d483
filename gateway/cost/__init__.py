"""Cycle time and torque reserve of an arm before and after the load data are entered."""
