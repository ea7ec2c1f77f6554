"""Robots as sold: nominal kinematics and a working volume, a file each in `hilcell/robots`.

A file has the tables [robot], [grid] and [base_frame] of a cell file; its comment names the source.
"""

from __future__ import annotations

import re
import tomllib
from importlib import resources

from hilcell.cell.file import BaseFrameTable, GridTable
from hilcell.cell.robot import RobotTable
from hilcell.cell.tables import Frozen
from hilcell.decoding import typed
from hilcell.identity import Identity


class KnownRobot(Frozen, frozen=True, kw_only=True):
    """A robot as sold. ``stated``: how its controllers name it; ``software``: their major version,
    where robots of two series have one name.
    """

    stated: list[str]
    software: int | None = None
    robot: RobotTable
    grid: GridTable
    base_frame: BaseFrameTable

    def likeness(self, identity: Identity) -> int:
        """Return how many words of a name a controller states; 0: another robot."""
        version = re.search(r"\d+", identity.firmware)
        if self.software not in (None, int(version[0]) if version else 0):
            return 0
        model, names = words(identity.model), map(words, self.stated)
        return max((len(name) for name in names if model[: len(name)] == name), default=0)


def known_robots(driver: str) -> dict[str, KnownRobot]:
    """Return the robots by name of the maker whose name a driver begins with, up to "-"."""
    maker = driver.partition("-")[0]
    files = (resources.files("hilcell") / "robots").iterdir()
    robots = [typed(tomllib.loads(file.read_text("utf-8")), KnownRobot) for file in files]
    return {
        each.robot.name: each
        for each in sorted(robots, key=lambda each: each.robot.name)
        if each.robot.driver.partition("-")[0] == maker
    }


def stated_robot(robots: dict[str, KnownRobot], identity: Identity) -> KnownRobot | None:
    """Return the robot whose controller this is; None for one that is not known."""
    likest = max(robots.values(), key=lambda each: each.likeness(identity), default=None)
    return likest if likest is not None and likest.likeness(identity) else None


def words(text: str) -> list[str]:
    return re.findall(r"[a-z0-9]+", text.casefold())
