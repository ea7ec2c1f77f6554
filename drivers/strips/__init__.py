"""Magnetic strips on a wire of their own."""
