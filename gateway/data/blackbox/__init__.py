"""The black box: the last seconds of all frames and samples before a stop, beside the recording."""
