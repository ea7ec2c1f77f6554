"""Procedures: steps in sequence, registered as entry points."""
