"""What leaves the house: results and controller formats."""
