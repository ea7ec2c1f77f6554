"""Deliberate breaks of the product, each of which `make test` must notice: `make mutants`."""
