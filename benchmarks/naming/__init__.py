"""Open benchmark: name the effect that the model of an arm lacks, from one table of rest poses, with hidden truth."""
