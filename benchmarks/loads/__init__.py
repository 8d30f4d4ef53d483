"""Open benchmark of loads: the gateway and public peers on the same tables, at rest and in motion, with hidden truth."""
