"""A device is locked by what it says it is, whatever its address."""

from pathlib import Path
from uuid import uuid4

import pytest

from hilcell.ports import Identity
from tests.hilcell.run.bed import Bed, Live
from tests.hilcell.run.rig import Points, procedure


def bed_at(folder: Path, identity: Identity) -> Bed:
    folder.mkdir()
    bed = Bed(folder)
    bed.rail.identity = identity
    return bed


def held(tmp_path: Path, first: Identity, second: Identity) -> tuple[int, Bed]:
    """Return how a second run ends while a first is paused."""
    other = bed_at(tmp_path / "first", first)
    with Live(other, procedure(Points(10**6))) as live:
        live.runner.post("pause")
        live.until("state", "paused")
        bed = bed_at(tmp_path / "second", second)
        code = bed.run(procedure(Points(1)))
        live.runner.stop()
    assert live.code == 4
    return code, bed


def test_one_device_at_two_addresses_is_locked(tmp_path: Path) -> None:
    serial = uuid4().hex
    code, bed = held(
        tmp_path,
        Identity("Rail", "drive", serial, "can0 node 5"),
        Identity("Rail", "drive", serial, "socket://192.0.2.1:3000 node 5"),
    )
    assert code == 6
    fault = bed.log().fault
    assert fault.startswith(f"Rail (drive, serial {serial}) is locked by run r (pid ")
    assert bed.log().life[-1].change.error["code"] == "HC-C04"
    assert bed.robot.moves == 0
    assert bed.run(procedure(Points(1))) == 0  # free again


@pytest.mark.parametrize(
    ("serial", "other", "simulated"),
    [("7-a", "7-b", False), ("0", "0", False), ("", "", False), ("7", "7", True)],
)
def test_devices_that_may_be_two_are_not(
    tmp_path: Path, serial: str, other: str, simulated: bool
) -> None:
    """A serial number of 0 is none; simulated devices share theirs."""
    unique = uuid4().hex
    first = Identity("Rail", unique, serial, "a", simulated=simulated)
    second = Identity("Rail", unique, other, "b", simulated=simulated)
    assert held(tmp_path, first, second)[0] == 0
