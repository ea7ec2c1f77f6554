"""Alarms of the drivers, one TOML file each; the entry point ``hilcell.alarms`` names them."""
