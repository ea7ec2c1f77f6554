"""The kinds of devices, and their errors: a driver raises `DeviceError` through its own kind."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

from hilcell.ports import DeviceError, DeviceRefused, NoReading

Wire = TypeVar("Wire")


@dataclass(frozen=True, slots=True)
class Device:
    """A kind of device: its name, and the alarms of a wire that does not open, is lost, or absent.

    ``fields`` of an error are the values behind its words.
    """

    name: str
    unreachable: str
    lost: str
    absent: str

    def failed(
        self,
        code: str,
        operation: str,
        found: str,
        *,
        wanted: str = "",
        act: str = "",
        **fields: object,
    ) -> DeviceError:
        return DeviceError(code, self.name, operation, found, wanted=wanted, act=act, fields=fields)

    def refused(
        self,
        code: str,
        operation: str,
        found: str,
        *,
        wanted: str = "",
        act: str = "",
        **fields: object,
    ) -> DeviceRefused:
        """Return why this device is not worked with."""
        return DeviceRefused(
            code, self.name, operation, found, wanted=wanted, act=act, fields=fields
        )

    def no_reading(
        self,
        code: str,
        operation: str,
        found: str,
        *,
        wanted: str = "",
        act: str = "",
        **fields: object,
    ) -> NoReading:
        """Return the error of one measurement that may be tried again."""
        return NoReading(code, self.name, operation, found, wanted=wanted, act=act, fields=fields)

    def unreached(self, address: str, found: str) -> DeviceError:
        return self.failed(self.unreachable, "connect", f"{address}: {found}", address=address)

    def broken(self, address: str, operation: str, found: str) -> DeviceError:
        return self.failed(self.lost, operation, f"{address}: {found}", address=address)

    def connected(self, wire: Wire | None) -> Wire:
        """Return a wire; raises `DeviceError` before it is opened, and after it was closed."""
        if wire is None:
            raise self.failed(self.absent, "use", "not connected")
        return wire


RAIL = Device("Rail", unreachable="HC-R04", lost="HC-R01", absent="HC-R38")
STRIP = Device("Rail", unreachable="HC-S11", lost="HC-S12", absent="HC-S12")
ROBOT = Device("Robot", unreachable="HC-B01", lost="HC-B02", absent="HC-B21")
TRACKER = Device("Tracker", unreachable="HC-T01", lost="HC-T02", absent="HC-T34")
