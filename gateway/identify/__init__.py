"""Common parts of all identifications: priors of links, loads and unloaded arms, and columns of moving runs."""
