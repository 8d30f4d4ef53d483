"""Recordings (HDF5): reader, writer, and the writer process."""
