"""Random cells: every planned way against an independent collision checker."""
