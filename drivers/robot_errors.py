"""Errors that all robots share, with the codes of their alarms."""

from __future__ import annotations

from drivers.motion_limits import MotionLimits
from drivers.wires.tcp import Alarms
from hilcell.ports import Array, DeviceError, DeviceRefused

DEVICE = "Robot"
ALARMS = Alarms(unreachable="HC-B01", lost="HC-B02")


def failed(
    code: str, found: str, *, wanted: str = "", act: str = "", **fields: object
) -> DeviceError:
    """Return the error of a motion."""
    return DeviceError(code, DEVICE, "move", found, wanted=wanted, act=act, fields=fields)


def refused(
    code: str, found: str, *, wanted: str = "", act: str = "", **fields: object
) -> DeviceRefused:
    """Return why this robot is not worked with."""
    return DeviceRefused(code, DEVICE, "connect", found, wanted=wanted, act=act, fields=fields)


def stalled(
    where: str, wanted: str, axes_deg: Array, waited_s: float, act: str = "see the panel, resume"
) -> DeviceError:
    """Return the error of a motion that gets no further; ``where`` says at which axes it stands."""
    found = f"no axis moved for {waited_s:.0f} s {where}"
    return failed("HC-B23", found, wanted=wanted, act=act, waited_s=waited_s, axes_deg=axes_deg)


def overdue(where: str, wanted: str, limits: MotionLimits, axes_deg: Array) -> DeviceError:
    """Return the error of a motion that takes far longer than was planned."""
    return failed(
        "HC-B29",
        f"still under way after {limits.spent_s:.0f} s at full speed, {where}",
        wanted=f"{wanted} within {limits.limit_s:.0f} s",
        act="the arm creeps; see the panel and robot.joint.speed_deg_s, resume",
        spent_s=limits.spent_s,
        limit_s=limits.limit_s,
        axes_deg=axes_deg,
    )


def stopped_short(at: str, wanted: str, axes_deg: Array, target_deg: Array) -> DeviceError:
    """Return the error of an arm that does not stand at its target after its acknowledgement."""
    return failed(
        "HC-B24",
        f"stands or creeps at {at}",
        wanted=f"{wanted} deg, at rest",
        act="the robot stopped short of its target; see the panel, resume",
        axes_deg=axes_deg,
        target_deg=target_deg,
    )
