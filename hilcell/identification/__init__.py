"""Kinematic identification: parameters of the arm and its gears from measured positions."""
