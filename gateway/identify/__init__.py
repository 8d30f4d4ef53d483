"""What every identification needs, once: priors of the links, loads and bare arms, columns of moving runs."""
