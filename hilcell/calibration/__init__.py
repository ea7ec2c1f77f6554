"""The calibration: its frames, its file, its checks, and how well a method fits."""
