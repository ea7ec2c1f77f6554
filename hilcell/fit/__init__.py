"""Robots measured elsewhere: their files, fitted methods, calibrated arms and targets."""
