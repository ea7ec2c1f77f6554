"""A recorded campaign is driven again: every pose of a CSV, every reflector, through the wires."""

from __future__ import annotations
