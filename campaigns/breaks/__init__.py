"""Deliberate breaks of the product, each of which a test of `make test` must notice."""
