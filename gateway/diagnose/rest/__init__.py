"""Diagnosis at rest: each hypothesis is fitted in full to the rest visits and weighted by its marginal likelihood."""
