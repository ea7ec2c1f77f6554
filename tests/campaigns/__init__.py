"""The campaigns can fail: their own machinery, and a part of each that is quick."""
