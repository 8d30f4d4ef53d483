"""Pre-flight check: drives are read and assessed before anything is written or moves."""
