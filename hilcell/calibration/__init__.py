"""The calibration: its frames, its file, its checks and its uncertainty."""
