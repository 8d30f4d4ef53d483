"""Recordings in the formats of other programs, and tables from what other programs logged."""
