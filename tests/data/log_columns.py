"""Columns of a map for logs: joint positions `q1`.. and joint torques `m1`.."""

COLUMNS = """\
[[column]]
log = "q{}"
table = "q{}_rad"
unit = "rad"
[[column]]
log = "m{}"
table = "tau{}_nm"
unit = "Nm"
"""
