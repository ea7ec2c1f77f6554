"""Recorded wires that play the devices again."""
