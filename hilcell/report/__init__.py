"""What a run found, for people: one HTML file, and tables for other programs."""
