"""The alarms of the procedures; found by the entry point ``hilcell.alarms``."""
