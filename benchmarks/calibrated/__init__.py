"""Coverage of stated intervals on tables that are drawn from the stated model itself."""
