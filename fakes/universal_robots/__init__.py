"""A controller of Universal Robots."""
