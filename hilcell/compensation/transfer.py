"""Data of station 1 used at station i: the slide is rigid, so the robot rides with it.

Eqs 11-13 and 17 in their corrected form: ``W_p(i) = W_Si T (W_S1 T)^-1 W_p(1)``; the constant
frame of {B} in {S} cancels. Nominal targets ride along as measured data do. Carrying
only the measured data loses the rail's offset, as if it were an error of the robot.
"""

from __future__ import annotations

from numpy.typing import ArrayLike

from hilcell.geometry.frames import apply, inverse
from hilcell.geometry.kinematics import Array


def ride(T_W_S1: Array, T_W_Si: Array) -> Array:
    """Return the motion (4, 4) in {W} that carries the slide from station 1 to station i."""
    return T_W_Si @ inverse(T_W_S1)


def base_at(T_W_S1: Array, T_W_Si: Array, T_W_B1: Array) -> Array:
    """Return {B} in {W} (4, 4) at station i from {B} at station 1."""
    return ride(T_W_S1, T_W_Si) @ T_W_B1


def transferred(
    T_W_S1: Array, T_W_Si: Array, nominal_mm: ArrayLike, actual_mm: ArrayLike
) -> tuple[Array, Array]:
    """Return nominal and measured points (N, 3) of station 1, in {W}, as they are at station i."""
    T = ride(T_W_S1, T_W_Si)
    return apply(T, nominal_mm), apply(T, actual_mm)
