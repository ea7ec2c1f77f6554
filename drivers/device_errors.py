"""The kinds of devices, and their errors: a driver raises `DeviceError` through its own kind."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Generic, TypeVar

from hilcell.ports import DeviceError, DeviceRefused, NoReading

Error = TypeVar("Error", bound=DeviceError)
Wire = TypeVar("Wire")


class ProtocolError(ValueError):
    """Bytes or text that are no packet, no reply or no value of a device's protocol."""


@dataclass(frozen=True, slots=True)
class Errors(Generic[Error]):
    """Makes errors of one class for one kind of device; ``fields`` are the values of its text."""

    kind: type[Error]
    device: str
    fields: Mapping[str, object]

    def __call__(
        self,
        code: str,
        operation: str,
        found: str,
        *,
        expected: str = "",
        act: str = "",
        **fields: object,
    ) -> Error:
        values = {**self.fields, **fields}
        return self.kind(
            code, self.device, operation, found, expected=expected, act=act, fields=values
        )


@dataclass(frozen=True, slots=True)
class Device:
    """A kind of device: its name, and the alarms of a wire that does not open, is lost, or absent.

    ``fields`` are values that each of its errors has.
    """

    name: str
    unreachable: str
    lost: str
    absent: str
    fields: Mapping[str, object] = field(default_factory=dict, compare=False)

    @property
    def failed(self) -> Errors[DeviceError]:
        return Errors(DeviceError, self.name, self.fields)

    @property
    def refused(self) -> Errors[DeviceRefused]:
        return Errors(DeviceRefused, self.name, self.fields)

    @property
    def no_reading(self) -> Errors[NoReading]:
        """Errors of one measurement that may be tried again."""
        return Errors(NoReading, self.name, self.fields)

    def at(self, **fields: object) -> Device:
        return replace(self, fields=fields)

    def unreached(self, address: str, found: str) -> DeviceError:
        return self.failed(self.unreachable, "connect", f"{address}: {found}", address=address)

    def broken(self, address: str, operation: str, found: str) -> DeviceError:
        return self.failed(self.lost, operation, f"{address}: {found}", address=address)

    def connected(self, wire: Wire | None) -> Wire:
        """Return a wire; raises `DeviceError` before it is opened, and after it was closed."""
        if wire is None:
            raise self.failed(self.absent, "use", "not connected", act="connect first")
        return wire


RAIL = Device("Rail", unreachable="HC-R04", lost="HC-R01", absent="HC-R38")
STRIP = Device("Rail", unreachable="HC-S11", lost="HC-S12", absent="HC-S12")
ROBOT = Device("Robot", unreachable="HC-B01", lost="HC-B02", absent="HC-B21")
TRACKER = Device("Tracker", unreachable="HC-T01", lost="HC-T02", absent="HC-T34")
