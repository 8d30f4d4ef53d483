"""Export of recordings to open formats, and import of tables from logs of other programs."""
