"""Arms as they stand in halls: everything ordinary at once, one of it harsh, and real mechanisms beyond.

What is ordinary has a physical form of its own and is drawn in its own range; no form, prior or range is shared with
the program that is tested on it. The `cell` module draws, `measuring` gives rows of a measured table, `strength` says
how much of a mechanism the rows can show at all.
"""
