"""Drafts of drive profiles: what a data sheet says, what it cannot say, and the file that follows from both."""
