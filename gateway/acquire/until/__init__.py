"""No longer than needed: which pose to measure next, and when a load is known well enough."""
