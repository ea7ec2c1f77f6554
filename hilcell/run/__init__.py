"""Runs: state machines, journal, interlocks, the worker and its control."""
