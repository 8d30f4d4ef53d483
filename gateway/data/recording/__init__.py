"""Recordings (HDF5): reader, writer, and the process that writes."""
