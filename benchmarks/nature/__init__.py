"""Arms as in the field: all nuisance effects at once, one of them strong, and further real mechanisms.

Each nuisance effect has its own physical form and range; no form, prior or range is shared with the program under test.
The `cell` module draws, `measuring` gives rows of a measured table, `strength` gives how much of a mechanism the rows
can show, `days` repeats a measurement over three days.
"""
