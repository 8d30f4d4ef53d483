"""Random cells: every planned path against an independent collision checker."""
