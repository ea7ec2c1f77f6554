"""Compensation of position errors: pure functions on measured grids."""
