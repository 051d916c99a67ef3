"""Measurements of the package itself on simulated robots, whose truth is known."""
