"""Drawings of the report: vector pictures of a run, each from its facts alone."""
