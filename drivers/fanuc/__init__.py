"""Programs of FANUC robots."""
