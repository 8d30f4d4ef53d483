"""Drive a path without and with feedforward, and compare the following errors."""
