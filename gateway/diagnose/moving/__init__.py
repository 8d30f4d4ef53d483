"""Diagnosis in motion: effects are added while the prediction of held-out rows improves."""
