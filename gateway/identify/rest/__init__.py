"""The arm at rest: rows, priors and the fit that estimates and diagnoses share."""
