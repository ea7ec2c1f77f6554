"""What stands in the cell: its file, its layout, its devices."""
