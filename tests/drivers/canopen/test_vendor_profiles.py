"""Drives as their makers sell them: units, objects of their own, and objects that they lack."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest

from drivers.canopen.cia import Object
from drivers.canopen.drive_units import Unit
from drivers.canopen.rail import CanopenRail
from drivers.canopen.vendor_profiles import TURN, VendorProfile, table, vendor_profiles
from fakes.canopen.rail_device import RailDevice
from fakes.canopen.slave import Abort, Entry, SdoAbortError
from fakes.in_process import EventClock
from tests.drivers.canopen.can_peer import DRIVE, CanPeer, u32
from tests.drivers.canopen.rail_bed import RailBed
from tests.drivers.canopen.test_rail_jog import options_of
from tests.drivers.peers import refusal
from tests.fakes.rail_bench import Bench, served

PROFILES = {each.make: each for each in vendor_profiles()}
PER_TURN = 4096
# What a drive of a make states as delivered, and the homing methods that it has.
AS_DELIVERED: dict[str, tuple[dict[tuple[int, int], int], tuple[int, ...]]] = {
    "Copley Controls": ({}, (17, 35)),
    "Elmo Gold": ({(0x6090, 1): 1, (0x6090, 2): 1}, (17, 35)),
    "maxon EPOS4": (
        {
            (0x60A8, 0): 0x00B50000,
            (0x60A9, 0): 0x00B44700,
            (0x60AA, 0): 0x00C00300,
            (0x3000, 5): PER_TURN,
        },
        (17, 37),
    ),
}


def hide(entry: Entry) -> None:
    """Let an object be absent on the wire; the simulated motor may still know its value."""

    def absent(*_: object) -> Any:
        raise SdoAbortError(Abort.NO_SUCH_OBJECT)

    entry.read = entry.write = absent


@contextmanager
def drive_of(make: VendorProfile) -> Iterator[Bench]:
    """Serve a drive of a make: its objects, and a motor that obeys its units."""
    stated, methods = AS_DELIVERED[make.make]
    unit: Any = make.speed_unit
    device = RailDevice(speed_unit=unit, counts_per_turn=PER_TURN, homing_methods=methods)
    with served(device=device) as bench:
        drive, scale = bench.server._drive, device.counts_per_mm
        entries = drive.dictionary._entries
        entries[0x1018, 1].value = make.vendor
        entries.update({key: Entry("I", value, "ro") for key, value in stated.items()})
        if make.home_offset != Object.HOME_OFFSET:
            offset = entries[Object.HOME_OFFSET, 0]

            def keep(value: int) -> None:
                offset.value = value

            entries[make.home_offset, 0] = Entry("i", 0, write=keep)
            hide(offset)
        for key in [(index, 0) for index in make.lacks if (index, 0) in entries]:
            hide(entries[key])
        ramp_mm_s2 = Unit.of(make.acceleration_unit).counts(scale, PER_TURN) / scale
        vars(drive)["_ramp_mm_s2"] = lambda ramp: ramp * ramp_mm_s2
        yield bench


def rail_at(bench: Bench, **options: Any) -> CanopenRail:
    stated = options_of(bench, **({"drive_product": 0} | options))
    return CanopenRail(stated, EventClock(bench.rail._time))


EACH = pytest.mark.parametrize("make", PROFILES.values(), ids=PROFILES)


@EACH
def test_a_drive_of_a_make_is_found_and_its_objects_are_listed(make: VendorProfile) -> None:
    with drive_of(make) as bench:
        (found,) = CanopenRail.discover({"channel": f"socket://127.0.0.1:{bench.server.port}"})
        assert found.options["drive_vendor"] == make.vendor
        rows = [each for each in rail_at(bench).inspect() if each.device == "Drive"]
    states = {each.feature.partition(" ")[0]: each.state for each in rows}
    stated, _ = AS_DELIVERED[make.make]
    missing = {int(name[:4], 16) for name, state in states.items() if state == "has not"}
    assert missing >= {*make.lacks}
    assert not {key[0] for key in stated} & missing
    assert not [each for each in rows if each.needed == "mandatory" and each.state == "has not"]
    assert states[f"{make.home_offset:04X}h"] == "has"


@EACH
def test_a_drive_of_a_make_moves_and_stops_in_its_unit(make: VendorProfile) -> None:
    with drive_of(make) as bench:
        ordered: list[tuple[float, float]] = []
        move = bench.rail.move

        def note(end_mm: float, speed_mm_s: float, ramp_mm_s2: float) -> None:
            ordered.append((speed_mm_s, ramp_mm_s2))
            move(end_mm, speed_mm_s, ramp_mm_s2)

        vars(bench.rail)["move"] = note
        with closing(rail_at(bench, drive_vendor=make.vendor)) as rail:
            rail.connect()
            rail.home()
            rail.move_to(400.0)
            assert rail.settle().position_mm == pytest.approx(400.0, abs=0.05)
            (speed_mm_s, ramp_mm_s2) = ordered[-1]
            coarse = 0.01  # of whole units
            assert speed_mm_s == pytest.approx(250.0, rel=coarse)
            assert ramp_mm_s2 == pytest.approx(200.0, rel=coarse)
            trace = rail.jog(-50.0, bound_mm=63.0, speed_mm_s=20.0, stop_after_mm=10.0)
            assert trace.stopped_by == "stop"
            assert abs(trace.velocity_mm_s).max() == pytest.approx(20.0, rel=0.1)
            assert 10.0 <= abs(bench.rail.slide_mm() - 400.0) < 15.0
            quick = bench.server._drive.dictionary.number(Object.QUICK_STOP_DECELERATION)
            assert quick >= bench.server._drive.dictionary.number(Object.PROFILE_ACCELERATION)
            rail.stop()
        assert bench.rail.at_rest


@EACH
def test_a_drive_of_a_make_takes_its_reference_from_the_strip(make: VendorProfile) -> None:
    (_, here) = AS_DELIVERED[make.make][1]
    with (
        drive_of(make) as bench,
        closing(rail_at(bench, drive_vendor=make.vendor, homing=here)) as rail,
    ):
        rail.connect()
        before = bench.rail.slide_mm()
        rail.home()
        reading = rail.settle()
        assert reading.position_mm == pytest.approx(reading.strip_mm, abs=0.06)
        assert bench.rail.slide_mm() == pytest.approx(before, abs=0.01)


def test_a_turn_that_a_make_states_elsewhere_contradicts_an_option() -> None:
    make = PROFILES["maxon EPOS4"]
    with drive_of(make) as bench:
        rail = rail_at(bench, drive_vendor=make.vendor, counts_per_turn=1000.0)
        assert refusal(rail.connect).code == "HC-R54"


def test_the_page_shows_the_makes() -> None:
    assert table() in (Path(__file__).parents[3] / "docs/hardware.md").read_text("utf-8")


@pytest.mark.parametrize(
    ("vendor", "stated", "options", "speed", "ramp"),
    [
        (0x484, {}, {}, 250_000, 200_000),
        (0xAB, {}, {}, 2_500_000, 20_000),  # 0.1 counts/s, 10 counts/s^2
        (0xAB, {}, {"speed_unit": "counts/s"}, 250_000, 200_000),
        (0xAB, {0x60A9: 0x00B50300}, {}, 250_000, 200_000),
        (0x484, {0x60A9: 0x00B44700}, {"counts_per_turn": 6000.0}, 2500, 2000),
        (0x484, {0x60A9: 0xFDB44700}, {"counts_per_turn": 6000.0}, 2_500_000, 2_000_000),
        (
            0x484,
            {0x60A9: 0xFDB44700, 0x60AA: 0x00C00300},
            {"counts_per_turn": 6e3},
            2_500_000,
            2000,
        ),
        (0x484, {0x60A9: 0xFDB40300, 0x60AA: 0xFDB45700}, {"counts_per_turn": 1e4}, 25000, 20000),
        (0x484, {}, {"speed_unit": "mm/s"}, 250, 200),
    ],
)
def test_units_are_the_options_else_the_drives_else_the_makes(
    bed: RailBed,
    peer: CanPeer,
    vendor: int,
    stated: dict[int, int],
    options: dict[str, object],
    speed: int,
    ramp: int,
) -> None:
    peer.objects[DRIVE][0x1018, 1] = u32(vendor)
    peer.objects[DRIVE] |= {(index, 0): u32(value) for index, value in stated.items()}
    bed.connect(drive_vendor=vendor, **options)
    assert peer.written(0x6081) == [u32(speed)]
    assert peer.written(0x6083) == [u32(ramp)]


@pytest.mark.parametrize(
    ("stated", "options"),
    [
        ({0x60A9: 0x00B44700}, {"speed_unit": "counts/s"}),
        ({0x60A9: 0x00B44700}, {}),  # rpm, and nobody knows the counts of a turn
        ({0x60A9: 0x00000100}, {}),  # no unit of speed
        ({0x60A9: 0x00B50300, 0x60AA: 0x00B55700}, {"acceleration_unit": "10 counts/s^2"}),
        ({0x60A9: 0x00B50300, 0x60AA: 0x00000100}, {}),  # no unit of acceleration
        ({0x60A8: 0xFA010000}, {"counts_per_mm": 900.0}),  # micrometres
    ],
)
def test_units_that_contradict_the_options_are_refused(
    bed: RailBed, peer: CanPeer, stated: dict[int, int], options: dict[str, object]
) -> None:
    peer.objects[DRIVE] |= {(index, 0): u32(value) for index, value in stated.items()}
    assert refusal(lambda: bed.connect(**options)).code == "HC-R54"


def test_each_make_has_one_profile() -> None:
    vendors = [each.vendor for each in PROFILES.values()]
    assert len(vendors) == len(set(vendors))
    assert set(PROFILES) == set(AS_DELIVERED)


def test_a_maker_that_is_not_known_has_the_objects_of_the_standard() -> None:
    assert (VendorProfile().turn, VendorProfile().home_offset) == (TURN, Object.HOME_OFFSET)
