"""A path driven without and with feedforward, and what the following error says about it."""
