"""Wires between a driver and its device: their places, and recordings of them."""
