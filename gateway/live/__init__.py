"""The live page: what happens under power, seen in a browser on the same computer."""
