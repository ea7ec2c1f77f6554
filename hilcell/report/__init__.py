"""Results of a run: one HTML file for people, tables for other programs."""
