"""Open benchmark of loads: the gateway and public peers on the same tables with hidden truth."""
