"""Draft a cell file for a new arm: read what is available, ask for the rest, mark assumptions.

`interview` defines the sequence; only `reading` accesses drives and files.
"""
