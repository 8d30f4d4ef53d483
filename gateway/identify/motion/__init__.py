"""Identification in motion: one model of moving rows, its noise, its solution and the loads that follow from it."""
