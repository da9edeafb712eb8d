"""Simulated plants: what a stem does under a light, learned from tracks."""
