"""Design studies: many simulated calibrations of cells that do not exist yet."""
