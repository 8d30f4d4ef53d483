"""Certificate, acceptance over the workspace and replay, measured on simulated arms."""
