"""The cell: its file, its layout, its devices."""
