"""Robots of ABB, and their programs."""
