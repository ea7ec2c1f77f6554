"""Pure mathematics of frames, fits and arms: arrays in, arrays out."""
