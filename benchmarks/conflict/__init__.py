"""How often wrong statements about an arm pass without a warning, on arms that share no code with the product."""
