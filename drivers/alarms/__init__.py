"""The alarms of the drivers, one TOML file each; found by the entry point ``hilcell.alarms``."""
