"""A strip's sensor on a CAN bus of its own: a second bus beside the drive's, and one that fails."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest

from drivers.canopen.rail import CanopenRail
from drivers.strips import LOST, CanopenStrip, StripFeed, StripOptions
from hilcell.ports import DeviceError, DeviceRefused, Stopped, StripLost
from tests.drivers.canopen.can_peer import STRIP, CanPeer, u8, u32
from tests.drivers.canopen.rail_bed import RailTime, peer, rail_for, time
from tests.drivers.peers import refusal, soon

__all__ = ["peer", "time"]


def never() -> None:
    pass


def options_for(peer: CanPeer, **more: Any) -> StripOptions:
    return StripOptions(driver="canopen", channel=peer.channel, **more)


@pytest.fixture
def bus(peer: CanPeer) -> CanPeer:
    return peer


@pytest.fixture
def strip(bus: CanPeer, time: RailTime) -> Iterator[CanopenStrip]:
    strip = CanopenStrip(options_for(bus), time)
    yield strip
    strip.close()
    strip.close()


def test_identity_readings_alarms_and_counts(bus: CanPeer, strip: CanopenStrip) -> None:
    identity = strip.connect()
    assert (identity.kind, identity.serial) == ("strip", "4711")
    assert identity.address == f"{bus.channel} node {STRIP}"
    assert strip.read(never) == (50_000, 0)
    bus.axis.position, bus.alarms = -1200, 1
    assert strip.read(never) == (-120, 1)
    frames = strip.statistics().frames
    assert frames > 10
    # Nothing is sent that could move a drive.
    assert {cob_id for cob_id, _ in bus.heard} <= {0x000, 0x080, 0x600 + STRIP}
    assert {data[1] for data in bus.frames(0x000)} == {STRIP}
    strip.close()
    assert strip.statistics().frames >= frames
    with pytest.raises(DeviceError):
        strip.read(never)


@pytest.mark.parametrize(
    ("more", "found"), [({"serial": 8}, "0x1267"), ({"product": 7}, "0x406"),
                        ({"counts_per_mm": 1000.0}, "10000 nm")],
)  # fmt: skip
def test_another_sensor_is_refused(
    bus: CanPeer, time: RailTime, more: dict[str, Any], found: str
) -> None:
    strip = CanopenStrip(options_for(bus, **more), time)
    with pytest.raises(DeviceRefused, match=found):
        strip.connect()
    assert bus.nmt[STRIP] != 5


def test_the_step_may_be_absent(bus: CanPeer, time: RailTime) -> None:
    del bus.objects[STRIP][0x6005, 1]
    bus.objects[STRIP][0x1018, 4] = u32(99)
    strip = CanopenStrip(options_for(bus, serial=99, counts_per_mm=50.0), time)
    assert strip.connect().serial == "99"
    strip.close()


def test_a_sensor_without_an_object_for_its_alarms_has_them_in_its_emergencies(
    bus: CanPeer, strip: CanopenStrip
) -> None:
    bus.unmappable.add(0x6503)
    strip.connect()
    assert strip.read(never) == (50_000, 0)
    bus.send(0x080 + STRIP, struct.pack("<HB5x", 0x7305, 0x21))
    assert soon(lambda: strip.read(never) == (50_000, 1))
    bus.send(0x080 + STRIP, struct.pack("<HB5x", 0x0000, 0))
    assert soon(lambda: strip.read(never) == (50_000, 0))


def test_a_sensor_that_is_reset_falls_silent_or_leaves_the_bus_is_lost(
    bus: CanPeer, strip: CanopenStrip, time: RailTime
) -> None:
    feed = StripFeed(strip)
    causes = (
        (lambda: bus.send(0x700 + STRIP, u8(0)), "boot-up"),
        (lambda: bus.nmt.__setitem__(STRIP, 0x7F), "not operational"),
        (bus.server.drop, "link lost"),
    )
    time.silence()
    for strike, said in causes:
        feed.connect()
        assert feed.poll(never) == (50_000, 0)
        strike()
        soon(lambda: bool(feed.poll(never)[1] & LOST))
        assert said in feed.alarm_text(LOST)
        bus.server.drop()
        feed.mend()
        assert feed.poll(never) == (50_000, 0)
    feed.close()


def test_a_stop_ends_the_wait(bus: CanPeer, strip: CanopenStrip, time: RailTime) -> None:
    strip.connect()
    bus.nmt[STRIP] = 0x7F
    bus.on_sync = time.stop.set
    with pytest.raises(Stopped):
        strip.read(time.check)


def test_a_drive_and_a_strip_each_on_a_bus_of_its_own(bus: CanPeer, time: RailTime) -> None:
    with CanPeer() as drive_bus:
        drive_bus.silent.add(STRIP)
        rail = rail_for(drive_bus, time, strip=options_for(bus), strip_counts_per_mm=3.0)
        drive_bus.on_sync = lambda: vars(bus.axis).update(
            position=drive_bus.axis.position, passed_s=drive_bus.axis.passed_s
        )
        drive, sensor = rail.connect()
        assert [each.kind for each in (drive, sensor)] == ["drive", "strip"]
        channels = [each.address.split()[0] for each in (drive, sensor)]
        assert channels == [drive_bus.channel, bus.channel]
        rail.home()
        rail.move_to(700.0)
        assert rail.settle().strip_mm == pytest.approx(700.0, abs=0.02)
        bus.nmt[STRIP] = 0x7F
        rail.move_to(800.0)  # no motion asks the strip
        rail.hold()
        assert rail.settle().strip_mm == pytest.approx(800.0, abs=0.02)  # it was opened again
        bus.alarms = 1
        found = refusal(rail.read)
        assert (type(found), found.fields["alarms"]) == (StripLost, 1)
        frames = rail.statistics().frames
        rail.close()
        assert rail.statistics().frames >= frames > 100


@pytest.mark.parametrize(
    ("strip", "found"),
    [
        ({"driver": "serial", "channel": "/dev/a", "node": 7}, "node"),
        ({"driver": "canopen", "channel": "can1"}, None),
        ({"driver": "canopen", "interface": "socketcan", "channel": "can1"}, None),
        ({"driver": "canopen", "channel": "socket://a"}, "channel"),
        ({"driver": "canopen", "channel": "socket://gateway:3000"}, "needs no table"),
        ({"driver": "canopen", "channel": "can1", "serial": 8}, "strip_serial"),
    ],
)
def test_options(strip: dict[str, Any], found: str | None) -> None:
    stated = {
        "channel": "socket://gateway:3000",
        "travel_min_mm": 0.0,
        "travel_max_mm": 3000.0,
        "speed_mm_s": 250.0,
        "acceleration_mm_s2": 200.0,
        "strip": strip,
        "strip_serial": strip.get("serial", 0),
    }
    if found is None:
        assert msgspec.convert(stated, CanopenRail.Options).strip is not None
    else:
        with pytest.raises(msgspec.ValidationError, match=found):
            msgspec.convert(stated, CanopenRail.Options)
