"""Plots as lines of text: arrays in, styled lines out; nothing here knows a run."""
