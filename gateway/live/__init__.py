"""Live page: state of the arms, shown in a browser on the same computer."""
