"""The alarms of the simulated cell; found by the entry point ``hilcell.alarms``."""
