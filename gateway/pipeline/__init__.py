"""Steps from data files to an estimate or a diagnosis, and to the complete result file."""
