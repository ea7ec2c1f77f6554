"""The terminal: its capabilities, its driver, the themes."""
