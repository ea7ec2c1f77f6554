"""A controller of KUKA by two wires."""
