"""Laser trackers and total stations of Leica."""
