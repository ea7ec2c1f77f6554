"""Robots of Universal Robots, and their programs."""
