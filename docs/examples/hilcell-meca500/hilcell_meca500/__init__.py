"""Robots of Mecademic for hilcell: driver, alarms, simulated controller, programs."""
