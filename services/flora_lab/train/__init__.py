"""Training: from tracks to simulators."""
