"""Evidence in motion: effects are added while rows that no fit has seen get better."""
