"""Many robots over months: how fast, how flat, how early, and how seldom falsely."""
