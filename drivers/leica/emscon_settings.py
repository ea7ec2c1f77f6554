"""The settings of an emScon tracker: written, read back, and read again where they changed.

They belong to the tracker, not to the connection. Another client may change them, and the tracker
then tells all its clients which one was changed, but not to which value.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from struct import Struct

import numpy as np

from drivers.leica import emscon
from drivers.leica.emscon import Change, Command, Layout
from drivers.tracker_readings import DEVICE, refused
from hilcell.ports import DeviceError

SHARE = 1e-6
SCALE_SHARE = 1e-9
CLOSE = "another program holds the tracker? close it, then resume"


@dataclass(frozen=True, slots=True)
class Setting:
    """How a setting is read, and the news that it was changed."""

    name: str
    read: Command
    layout: Struct
    changes: tuple[Change, ...]


@dataclass(frozen=True, slots=True)
class Writable(Setting):
    """A setting that can be written, too."""

    write: Command


class EmsconSettings:
    """The values that the tracker is set to, and the news of those that somebody changed."""

    UNITS = Writable("units", Command.GET_UNITS, Layout.UNITS, (Change.UNITS,), Command.SET_UNITS)
    AXES = Writable(
        "coordinate system",
        Command.GET_COORDINATE_SYSTEM,
        Layout.NUMBER,
        (Change.COORDINATE_SYSTEM,),
        Command.SET_COORDINATE_SYSTEM,
    )
    MODE = Writable(
        "measurement mode",
        Command.GET_MEASUREMENT_MODE,
        Layout.NUMBER,
        (Change.MEASUREMENT_MODE,),
        Command.SET_MEASUREMENT_MODE,
    )
    STATIONARY = Writable(
        "stationary parameters",
        Command.GET_STATIONARY,
        Layout.STATIONARY,
        (Change.STATIONARY,),
        Command.SET_STATIONARY,
    )
    CONTINUOUS = Writable(
        "continuous time parameters",
        Command.GET_CONTINUOUS_TIME,
        Layout.CONTINUOUS,
        (Change.CONTINUOUS_TIME,),
        Command.SET_CONTINUOUS_TIME,
    )
    SEARCH = Writable(
        "search", Command.GET_SEARCH, Layout.SEARCH, (Change.SEARCH,), Command.SET_SEARCH
    )
    REFLECTOR = Writable(
        "reflector",
        Command.GET_REFLECTOR,
        Layout.NUMBER,
        (Change.REFLECTOR,),
        Command.SET_REFLECTOR,
    )
    FACE = Setting("face", Command.GET_FACE, Layout.NUMBER, (Change.FIRST_FACE, Change.SECOND_FACE))
    SYSTEM = Setting(
        "weather monitor, transformation and orientation in use",
        Command.GET_SYSTEM_SETTINGS,
        Layout.SYSTEM_SETTINGS,
        (Change.SYSTEM_SETTINGS,),
    )
    ORIENTATION = Setting(
        "station orientation", Command.GET_ORIENTATION, Layout.ORIENTATION, (Change.ORIENTATION,)
    )
    TRANSFORMATION = Setting(
        "transformation",
        Command.GET_TRANSFORMATION,
        Layout.TRANSFORMATION,
        (Change.TRANSFORMATION,),
    )

    def __init__(
        self,
        ask: Callable[[Command, bytes], bytes],
        numbers_of: Callable[[Command, Struct], tuple[float, ...]],
    ) -> None:
        self._ask, self._numbers_of = ask, numbers_of
        self._kept: dict[Setting, tuple[float, ...]] = {}
        self._news: set[int] = set()

    def write(self, setting: Writable, *values: float) -> None:
        """Write a setting and believe it only when it reads back."""
        self._ask(setting.write, setting.layout.pack(*values))
        self.expect(setting, *values)

    def expect(self, setting: Setting, *values: float) -> None:
        """Refuse a setting that does not read as these values, and keep them.

        Lengths are converted from and to the tracker's own unit, so their last digits may differ.
        """
        found = self._numbers_of(setting.read, setting.layout)
        self._news.difference_update(setting.changes)  # our own; the reading is younger
        if not _same(found, values):
            raise refused(
                "HC-T06",
                f"set {setting.name}",
                f"reads back as {found}",
                wanted=f"{values}",
                act=CLOSE,
                setting=setting.name,
                read=found,
                written=values,
            )
        self._kept[setting] = values

    def keep(self, setting: Setting) -> tuple[float, ...]:
        """Return a setting that is left as it is, and must stay so."""
        self._kept[setting] = found = self._numbers_of(setting.read, setting.layout)
        return found

    def keep_frame(self) -> None:
        """Keep the frame in which the tracker measures; refuse one that stretches lengths.

        A controller that does not tell its system settings is older, and tells none of these.
        """
        try:
            if not self._ask(self.SYSTEM.read, b""):
                return
        except DeviceError as refusal:
            if refusal.fields.get("status") != emscon.NOT_IMPLEMENTED:
                raise
            return
        _weather, transforms, _orients = self.keep(self.SYSTEM)
        self.keep(self.ORIENTATION)
        scale = self.keep(self.TRANSFORMATION)[-1]
        if transforms and not abs(scale - 1.0) <= SCALE_SHARE:
            raise refused(
                "HC-T06",
                "connect",
                f"a transformation of scale {scale:.9g} is in use",
                wanted="1",
                act="switch it off or set its scale to 1 in the tracker's software, then resume",
                setting=self.TRANSFORMATION.name,
                scale=scale,
            )

    def hear(self, change: int) -> None:
        """Take the news of a change; nothing is asked yet."""
        self._news.add(change)

    def prove(self) -> None:
        """Read each setting again that was changed; raises `DeviceError` where it is not ours."""
        if Change.COMPENSATION in self._news:
            raise _changed("compensation", "it was changed", "the one of before")
        all_of_them = Change.SERVER_STARTED in self._news
        for setting in self._kept:
            if all_of_them or not self._news.isdisjoint(setting.changes):
                self.read_again(setting)
        self._news.clear()

    def read_again(self, setting: Setting) -> None:
        """Raise `DeviceError` where a setting is no longer the kept one."""
        found, kept = self._numbers_of(setting.read, setting.layout), self._kept[setting]
        if not _same(found, kept):
            raise _changed(setting.name, f"now reads {found}", f"{kept}")


def _same(found: tuple[float, ...], expected: tuple[float, ...]) -> bool:
    return bool(np.allclose(found, expected, rtol=SHARE, atol=SHARE))


def _changed(name: str, found: str, expected: str) -> DeviceError:
    return DeviceError(
        "HC-T06",
        DEVICE,
        f"read {name} again",
        found,
        wanted=expected,
        act="another program changed it: close that program; resume sets all settings again",
        fields={"setting": name},
    )
