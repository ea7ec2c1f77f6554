"""The order in which CiA 301, 7.5.2.36 wants a PDO mapped: strict devices refuse any other."""

from typing import cast

import pytest

from drivers.canopen.process_image import Pdo, Transmission
from drivers.canopen.sdo import SdoChannel

PDO = Pdo(0x1801, 0x285, Transmission.EVERY_SYNC, (0x606C, 0x6061), "<ib")


class Objects:
    """Keeps what is written, in its order."""

    def __init__(self, cob_id: int) -> None:
        self.cob_id = cob_id
        self.written: list[tuple[int, int, int]] = []

    def read(self, index: int, sub: int = 0) -> int:
        assert (index, sub) == (0x1801, 1)
        return self.cob_id

    def write(self, index: int, sub: int, value: int) -> None:
        self.written.append((index, sub, value))

    def offer(self, index: int, sub: int, value: int) -> None:
        self.write(index, sub, value)

    def require(self, index: int, sub: int, value: int, _what: str) -> None:
        self.write(index, sub, value)


@pytest.mark.parametrize("kept", [0, Pdo.NO_RTR])
def test_a_pdo_is_off_while_it_is_mapped(kept: int) -> None:
    objects = Objects(kept | 0x123)
    PDO.configure(cast("SdoChannel", objects))
    assert objects.written == [
        (0x1801, 1, Pdo.DISABLED | kept | 0x285),
        (0x1A01, 0, 0),
        (0x1A01, 1, 0x606C0020),
        (0x1A01, 2, 0x60610008),
        (0x1A01, 0, 2),
        (0x1801, 2, 1),
        (0x1801, 1, kept | 0x285),
    ]
