"""Records of all cells of a plant in one database: shipped from journals, asked by engineers."""
