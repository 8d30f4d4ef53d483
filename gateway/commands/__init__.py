"""The commands of `servo-gateway`, one module per group; imported only when one of its commands is called."""
