"""Commissioning: from an empty cell file to a cell that is ready to calibrate."""
