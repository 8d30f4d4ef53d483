"""Fleet of robots over months: store of checks, repeated estimation, drift detection, and robots that need service."""
