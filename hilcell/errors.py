"""What hilcell raises: one clear message each, whoever reads it.

Apart from `hilcell.ports`, so that a face can say an error without loading arrays.
"""

from __future__ import annotations


class HilcellError(Exception):
    """Anything hilcell says to its user in one clear message."""


class Stopped(HilcellError):
    """The operator, or the program's end, asked everything to stop."""


class DeviceError(HilcellError):
    """A device failed: names device, operation, wanted and found values, cause and next act.

    ``told`` is the same without the act, for who advises better.
    """

    def __init__(
        self, device: str, operation: str, found: str, *, wanted: str = "", act: str = ""
    ) -> None:
        self.device, self.operation, self.found = device, operation, found
        self.wanted, self.act = wanted, act
        self.told = f"{device}: {operation}: {found}" + (f", wanted {wanted}" if wanted else "")
        super().__init__(self.told + (f"; {act}" if act else ""))


class DeviceRefused(DeviceError):
    """The device answers, but is not what the cell file says, or is not allowed to work."""


class NoReading(DeviceError):
    """The device is well, yet this one measurement failed and may be tried again."""
