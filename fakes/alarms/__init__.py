"""Alarms of the simulated cell; the entry point ``hilcell.alarms`` names them."""
