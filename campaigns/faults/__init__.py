"""Faults, and pairs of faults, in every phase of a run."""
