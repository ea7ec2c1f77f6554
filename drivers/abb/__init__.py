"""Robots of ABB: their controllers by web services, and their programs."""
