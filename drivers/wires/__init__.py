"""Wires to devices: TCP, serial lines, lines of text."""
