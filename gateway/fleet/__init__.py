"""Many robots over months: a store of checks, everything estimated anew, what drifts, and who needs a visit."""
