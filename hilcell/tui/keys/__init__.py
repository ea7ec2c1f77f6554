"""What the keys do, and in which order."""
