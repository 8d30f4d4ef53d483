"""A cell file for an arm that nobody has described yet: what can be read is read, what cannot is asked, guesses say so.

`interview` is the order of the job; `reading` alone talks to drives and files, everything else is values and text.
"""
