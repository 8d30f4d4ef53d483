"""Draft a drive profile from a data sheet and the engineer's answers."""
