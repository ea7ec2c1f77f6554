"""Procedures: what is done and in which order; found through entry points."""
