"""Procedures: acts in their order; found through entry points."""
