"""Alarms of the driver; found by the entry point ``hilcell.alarms``."""
