"""Robots measured elsewhere: their files, methods fitted to them, calibrated arms and targets."""
