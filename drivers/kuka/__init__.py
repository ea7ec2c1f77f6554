"""Robots of KUKA by two wires, their external axis, and their programs."""
