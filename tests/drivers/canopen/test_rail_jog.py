"""A rail whose scale, sign, unit or node numbers the cell file states wrongly, by a clock."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from threading import Event
from typing import Any

import numpy as np
import pytest

from drivers.canopen.drive import Drive
from drivers.canopen.rail import CanopenRail
from drivers.canopen.slcan_bus import SlcanBus
from fakes.canopen.rail_device import RailDevice
from fakes.canopen.slcan_gateway import SlcanGateway
from fakes.in_process import EventClock
from hilcell.clock import WallClock
from hilcell.ports import AfterLoss, DeviceError
from tests.drivers.canopen.test_units_of_the_drive import PACE, SlowClock
from tests.drivers.peers import refusal, soon
from tests.fakes.rail_bench import Bench, served

MOTOR: dict[str, Any] = {"motor_mm_s": 500.0, "motor_mm_s2": 2000.0}
TRAPS: dict[str, RailDevice] = {
    "as stated": RailDevice(),
    "drive sign": RailDevice(counts_per_mm=-1000.0),
    "strip sign": RailDevice(strip_counts_per_mm=-100.0),
    "scale x 0.9": RailDevice(counts_per_mm=1000.0 / 0.9),
    "scale x 10": RailDevice(counts_per_mm=100.0),
    "scale x 200": RailDevice(counts_per_mm=5.0),
    "rpm": RailDevice(speed_unit="rpm", **MOTOR),
    "0.1 counts/s": RailDevice(speed_unit="0.1 counts/s"),
}


def options_of(bench: Bench, **options: Any) -> CanopenRail.Options:
    values: dict[str, Any] = {
        "channel": f"socket://127.0.0.1:{bench.server.port}",
        "travel_min_mm": 0.0,
        "travel_max_mm": 3000.0,
        "speed_mm_s": 250.0,
        "acceleration_mm_s2": 200.0,
    }
    return CanopenRail.Options(**(values | options))


class SentClock(EventClock):
    """A stepped clock: time passes once the peer has taken each frame that was sent before."""

    def __init__(self, bench: Bench) -> None:
        super().__init__(bench.server._time)
        self.sent = self.taken = 0

    @contextmanager
    def counting(self) -> Iterator[None]:
        with pytest.MonkeyPatch.context() as patch:
            send, transmit = SlcanBus.send, SlcanGateway._transmit

            def sent(bus: SlcanBus, *frame: Any) -> None:
                self.sent += 1
                send(bus, *frame)

            def taken(gateway: SlcanGateway, line: bytes) -> None:
                transmit(gateway, line)
                self.taken += 1

            patch.setattr(Drive, "STALL_S", 60.0)  # a deadline of the wire, in real time
            patch.setattr(SlcanBus, "send", sent)
            patch.setattr(SlcanGateway, "_transmit", taken)
            yield

    def wait(self, duration_s: float) -> None:
        before = self.sent
        soon(lambda: self.taken >= before)
        super().wait(duration_s)


@contextmanager
def connected(
    device: RailDevice, *, paced: bool = False, **options: Any
) -> Iterator[tuple[CanopenRail, Bench]]:
    """Connect a rail in stepped time, or paced where the wire's own delays count."""
    with ExitStack() as at_end:
        bench = at_end.enter_context(served(device=device, **({"speed": PACE} if paced else {})))
        clock: EventClock | SlowClock = SlowClock()
        if not paced:
            clock = SentClock(bench)
            at_end.enter_context(clock.counting())
        with closing(CanopenRail(options_of(bench, **options), clock)) as rail:
            rail.connect()
            yield rail, bench


@pytest.mark.wall
@pytest.mark.parametrize(
    ("trap", "stopped_by", "ratio"),
    [("as stated", "", 1.0), ("scale x 10", "bound", 10.0), ("rpm", "", 1.0)],
)
def test_a_jog_stays_within_its_bound_by_the_wires_own_delays(
    trap: str, stopped_by: str, ratio: float
) -> None:
    bound_mm = 8.0
    with connected(TRAPS[trap], paced=True) as (rail, bench):
        began_mm = bench.rail.slide_mm()
        trace = rail.jog(5.0, bound_mm=bound_mm, speed_mm_s=5.0)
        assert bench.rail.at_rest
        assert not rail.read().powered
        assert abs(bench.rail.slide_mm() - began_mm) <= bound_mm
        assert np.abs(trace.strip_mm - trace.strip_mm[0]).max() <= bound_mm
        assert trace.stopped_by == stopped_by
        assert np.ptp(trace.strip_mm) / np.ptp(trace.drive_mm) == pytest.approx(ratio, rel=0.08)


@pytest.mark.parametrize("trap", TRAPS)
@pytest.mark.parametrize("second", [(0.5, 2.0), (5.0, 8.0)])
def test_a_jog_stays_within_its_bound_in_stepped_time(
    trap: str, second: tuple[float, float]
) -> None:
    with connected(TRAPS[trap]) as (rail, bench):
        stopped_by = []
        for distance_mm, bound_mm in ((0.05, 10.5), second):
            began_mm = bench.rail.slide_mm()
            trace = rail.jog(distance_mm, bound_mm=bound_mm, speed_mm_s=5.0)
            assert bench.rail.at_rest
            assert not rail.read().powered
            assert np.ptp(trace.strip_mm) <= bound_mm
            assert abs(bench.rail.slide_mm() - began_mm) <= bound_mm
            stopped_by.append(trace.stopped_by)
            if trace.stopped_by:
                break
        expected = {"scale x 200": ["bound"], "scale x 10": ["", "bound"]}
        assert stopped_by == expected.get(trap, ["", ""])


def test_a_stop_on_purpose_ends_a_jog() -> None:
    with connected(RailDevice()) as (rail, _):
        trace = rail.jog(20.0, bound_mm=30.0, speed_mm_s=50.0, stop_after_mm=5.0)
        assert trace.stopped_by == "stop"
        assert 5.0 <= np.ptp(trace.drive_mm) < 20.0
        assert not rail.read().powered


def pulled(rail: CanopenRail, bench: Bench) -> tuple[float, AfterLoss]:
    """Pull the cable while the slide moves and plug it in again; return how far the slide went
    without the PC, and how its drive stood then.
    """
    bench.faults.set("rail.unplugged", 3.0, after=300)
    trace = rail.jog_until_lost(300.0, bound_mm=363.0, speed_mm_s=20.0)
    assert trace.stopped_by == "lost"
    assert 5.0 < np.ptp(trace.strip_mm) < 150.0
    assert refusal(rail.close).code == "HC-R37"
    while True:
        with suppress(DeviceError):
            state = rail.regain()
            break
    reading = rail.settle()
    assert not reading.powered
    assert rail.jog(-5.0, bound_mm=9.0, speed_mm_s=5.0).stopped_by == ""
    return float(reading.strip_mm - trace.strip_mm[-1]), state


@pytest.mark.waits
@pytest.mark.parametrize("watchful", [True, False])
def test_a_drive_that_does_not_notice_a_lost_pc_is_noticed(watchful: bool) -> None:
    with connected(RailDevice(watchful=watchful)) as (rail, bench):
        began_mm = bench.rail.slide_mm()
        gone_mm, state = pulled(rail, bench)
        assert bench.rail.slide_mm() - began_mm <= 301.0
    assert state.stopped == watchful
    assert ("heartbeat" if watchful else "operation enabled") in state.text
    assert (gone_mm <= 24.0) == watchful


@pytest.mark.wall
def test_a_drive_without_its_pc_brakes_after_a_second() -> None:
    with served(1.0) as bench, closing(CanopenRail(options_of(bench), WallClock(Event()))) as rail:
        rail.connect()
        gone_mm, state = pulled(rail, bench)
        assert state.stopped
        assert 15.0 <= gone_mm <= 20.0 * (rail.own_stop_s + 0.25) + 1.5


@pytest.mark.parametrize(
    ("device", "factors", "options"),
    [
        (RailDevice(counts_per_mm=-1000.0), (-1.0, 1.0, 1.0), {}),
        (
            RailDevice(counts_per_mm=100.0),
            (10.0, 1.0, 10.0),
            {"standstill_window_mm": 0.1},  # its servo dithers by two coarse counts
        ),
        (RailDevice(strip_counts_per_mm=-100.0), (1.0, -1.0, 1.0), {}),
        (RailDevice(speed_unit="0.1 counts/s"), (1.0, 1.0, 0.1), {}),
        (RailDevice(speed_unit="rpm", **MOTOR), (1.0, 1.0, 166.7), {}),
        (RailDevice(speed_unit="rpm", states_units=True, **MOTOR), (1.0, 1.0, 1.0), {}),
        (
            RailDevice(speed_unit="rpm", **MOTOR),
            (1.0, 1.0, 1.0),
            {"speed_unit": "rpm", "counts_per_turn": 10_000},
        ),
    ],
)
def test_with_rescaled_options_drive_strip_and_speed_agree(
    device: RailDevice, factors: tuple[float, float, float], options: dict[str, Any]
) -> None:
    with connected(device, **options) as (rail, _):
        better: dict[str, Any] = rail.rescaled(*factors)
    with connected(device, **(options | better)) as (rail, bench):
        began_mm = bench.rail.slide_mm()
        trace = rail.jog(30.0, bound_mm=40.0, speed_mm_s=20.0)
        assert trace.stopped_by == ""
        assert np.diff(trace.taken_s)[-3:].min() >= Drive.POLL_S  # a busy PC gets through the dwell
        assert bench.rail.slide_mm() - began_mm == pytest.approx(30.0, abs=0.3)
        for gone_mm in (trace.drive_mm, trace.strip_mm):
            assert gone_mm[-1] - gone_mm[0] == pytest.approx(30.0, abs=0.3)
        assert np.median(trace.velocity_mm_s[trace.velocity_mm_s > 10]) == pytest.approx(
            20, rel=0.05
        )


def test_exchanged_node_numbers_are_named() -> None:
    with served(device=RailDevice(drive_node=6, strip_node=5)) as bench:
        rail = CanopenRail(options_of(bench), EventClock(bench.server._time))
        found = refusal(rail.connect)
        assert (found.code, found.fields["drive_node"]) == ("HC-R08", 5)
        assert "exchanged" in found.found


@pytest.mark.parametrize("method", [17, 18, 37, "absolute"])
@pytest.mark.parametrize("sign", [1, -1])
def test_after_homing_drive_and_strip_agree(method: Any, sign: Any) -> None:
    device = RailDevice(
        counts_per_mm=-1000.0,
        absolute=method == "absolute",
        homing_methods=() if method == "absolute" else (method,),
        home_offset_sign=sign if method == 37 else 1,
    )
    home_mm = {17: 3000.0}.get(method, 0.0)
    with connected(device, counts_per_mm=-1000.0, homing=method, home_mm=home_mm) as (rail, _):
        rail.home()
        reading = rail.settle()
        assert reading.position_mm == pytest.approx(reading.strip_mm, abs=0.8)
        inwards_mm = -2.0 if home_mm else 2.0
        trace = rail.jog(inwards_mm, bound_mm=4.0, speed_mm_s=5.0)
        assert trace.strip_mm[-1] - trace.strip_mm[0] == pytest.approx(inwards_mm, abs=0.5)
