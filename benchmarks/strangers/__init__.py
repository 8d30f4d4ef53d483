"""What strangers bring: drawn with fixed seeds, and either read right or answered with what to type."""
