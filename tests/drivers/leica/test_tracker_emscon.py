"""An emScon tracker: measurements, both faces, and settings that another program changes."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import pytest

from drivers.leica.tracker_emscon import LeicaEmsconTracker
from hilcell.ports import (
    Aims,
    Air,
    DeviceError,
    DeviceRefused,
    Discovers,
    Inspects,
    NoReading,
    Stopped,
    Tracker,
)
from tests.drivers.leica.emscon_bed import POINT, SMR, EmsconBed, Quick, measuring, punctual
from tests.drivers.leica.emscon_peer import (
    CLOSING,
    NOT_READY,
    READY,
    EmsconPeer,
    failure,
    reflector,
    reply,
    result,
)
from tests.drivers.peers import Server, in_thread, kind, refusal


def test_connecting_sets_everything_and_returns_the_identity(bed: EmsconBed) -> None:
    peer = bed.peer
    peer.initialized = 3
    tracker = bed.make(serial="390793", find_radius_mm=50.0)
    (identity,) = tracker.connect()
    assert (identity.serial, identity.model) == ("390793", "Leica, emScon 3.8.900")
    assert (identity.kind, identity.maker) == ("tracker", "Leica")
    assert (identity.firmware, identity.simulated) == ("emScon 3.8.900", False)
    assert 7 in peer.commands
    assert peer.settings[6] == struct.pack("<5I", 1, 0, 0, 0, 0)
    assert peer.settings[27] == peer.settings[25] == struct.pack("<i", 0)
    assert peer.settings[29] == struct.pack("<ii", 100, 1)
    assert peer.settings[41] == struct.pack("<i", 9)
    assert peer.settings[44].hex() == "000000000000494010270000"  # 50 mm, 10 s


@pytest.mark.parametrize("name", ["AT401", "AT401 (simulated)"])
def test_a_tracker_reports_its_name(bed: EmsconBed, name: str) -> None:
    field = name.encode("utf-16-le").ljust(64, b"\0")
    body = struct.pack("<I64s", 8, field) + bytes(80)
    bed.peer.answers[132] = partial(lambda body, _: [reply(132, body)], body)
    tracker = bed.make()
    (identity,) = tracker.connect()
    assert identity.model == f"Leica {name}, emScon 3.8.900"
    assert identity.simulated is ("simulated" in name)
    bed.peer.answers[132] = lambda _: [failure(132, 2)]  # it need not have one
    (identity,) = tracker.connect()
    assert identity.model == "Leica, emScon 3.8.900"


@pytest.mark.parametrize(
    ("found_mm", "same"),
    [
        (5.001, False),
        (np.nan, False),
        (np.inf, False),
        (np.nextafter(5.0, 6.0), True),
    ],  # kept in metres
)
def test_a_search_radius_that_reads_back_differently_is_refused(
    bed: EmsconBed, found_mm: float, same: bool
) -> None:
    bed.peer.answers[44] = lambda _: [reply(44, struct.pack("<di", found_mm, 10_000))]
    if same:
        bed.connect()
    else:
        assert kind(refusal(bed.make().connect)) == (DeviceRefused, "HC-T06")


def test_one_measurement(tracker: Quick) -> None:
    port: Tracker = tracker
    before = len(tracker.peer.commands)
    tracker.time.wait(1.0)
    reading = port.measure(POINT, SMR, 1)
    np.testing.assert_array_equal(reading.xyz_mm, POINT)
    np.testing.assert_array_equal(reading.std_mm, [0.0025] * 3)
    assert reading.air == Air(22.5, 1013.25, 45.0)
    assert (reading.samples, reading.taken_s) == (1, tracker.time.pc_s())
    assert tracker.peer.commands[before:] == [55, 49, 41]


def test_a_reading_is_as_old_as_its_result(tracker: Quick) -> None:
    def late(_: bytes) -> list[bytes]:
        tracker.time.wait(0.3)
        return [reply(41, tracker.peer.settings[41])]

    tracker.peer.answers[41] = late  # the read-back behind the result
    before_s = tracker.time.pc_s()
    reading = tracker.measure(POINT, SMR, 1)
    assert (reading.taken_s, tracker.time.pc_s()) == (before_s, before_s + 0.3)


def test_several_samples_give_mean_and_spread(tracker: Quick) -> None:
    offsets = iter([-0.01, 0.0, 0.01])
    tracker.peer.answers[49] = lambda _: [reply(49), result(POINT + [next(offsets), 0, 0])]
    reading = tracker.measure(POINT, SMR, 3)
    np.testing.assert_allclose(reading.xyz_mm, POINT, atol=1e-12)
    np.testing.assert_allclose(reading.std_mm, [0.01, 0, 0], atol=1e-9)
    assert reading.samples == 3


def test_another_reflector_is_chosen_by_name(tracker: Quick) -> None:
    tracker.measure(POINT, "SMR 0.5in", 1)
    assert tracker.peer.settings[41] == struct.pack("<i", 4)


def test_results_of_an_earlier_measurement_are_dropped(tracker: Quick) -> None:
    late = result(POINT + [1.0, 0, 0])
    tracker.peer.server.send(late)
    tracker.peer.answers[49] = lambda _: [late, reply(49), result(POINT)]
    np.testing.assert_array_equal(tracker.measure(POINT, SMR, 1).xyz_mm, POINT)


@pytest.mark.parametrize("at_once", [True, False])
def test_a_late_result_behind_the_acknowledgement_is_no_reading(
    tracker: Quick, at_once: bool
) -> None:
    peer = tracker.peer
    late, right = result(POINT + [0.003, 0, 0]), result(POINT)
    proof = iter([[reply(41, status=1)], [right, reply(41, peer.settings[41])]])
    peer.answers[49] = lambda _: [reply(49), late, READY, right] if at_once else [reply(49), late]
    if not at_once:
        peer.answers[41] = lambda _: next(proof)  # busy: it still measures
    error = measuring(tracker)
    assert (type(error), error.code, error.fields["results"]) == (NoReading, "HC-T31", 2)
    assert peer.commands[-1] == 52
    peer.answers[49] = lambda _: [reply(49), READY, right]
    peer.answers[41] = lambda _: [reply(41, peer.settings[41])]
    np.testing.assert_array_equal(tracker.measure(POINT, SMR, 1).xyz_mm, POINT)


def test_no_result_is_no_reading_and_the_next_one_is_good(
    monkeypatch: pytest.MonkeyPatch, tracker: Quick
) -> None:
    punctual(monkeypatch, tracker)
    good = tracker.peer.answers[49]
    tracker.peer.answers[49] = lambda _: tracker.time.behind([reply(49)], 0.1)
    tracker.peer.answers[52] = lambda _: tracker.time.behind(
        [result(POINT + [2, 0, 0]), reply(52)], 0.0
    )
    assert measuring(tracker).code == "HC-T13"
    tracker.peer.answers[49] = good
    np.testing.assert_array_equal(tracker.measure(POINT, SMR, 1).xyz_mm, POINT)


@pytest.mark.parametrize(
    ("answer", "code"),
    [
        ([failure(49, 10004)], "HC-T11"),
        ([reply(49), NOT_READY], "HC-T10"),
        ([reply(49), failure(49, 10009)], "HC-T15"),
        ([reply(49), failure(64, 37)], "HC-T11"),
        ([reply(49), result(POINT, status=10009)], "HC-T15"),
        ([reply(49, status=94)], "HC-T05"),
    ],
)
def test_a_measurement_that_fails_is_stopped_and_no_reading(
    tracker: Quick, answer: list[bytes], code: str
) -> None:
    tracker.peer.answers[49] = lambda _: answer
    error = measuring(tracker)
    assert (type(error), error.code, tracker.peer.commands[-1]) == (NoReading, code, 52)


@pytest.mark.parametrize(
    ("bad", "code"),
    [
        (result(POINT, std=0.051), "HC-T15"),
        (result(POINT, std=-0.001), "HC-T15"),
        (result(POINT, std=float("nan")), "HC-T14"),
        (result((float("inf"), 0, 0)), "HC-T14"),
        (result((1e308, 1e308, 1e308)), "HC-T14"),
        (result(POINT, std=1e308), "HC-T14"),
        (result(POINT, std=-1e300), "HC-T14"),
        (result((0.0, -1e200, 0.0)), "HC-T14"),
        (result(POINT + [0, 5.1, 0]), "HC-T16"),
        (result(POINT, air=(22.5, 0.0, 45.0)), "HC-T05"),
        (result(POINT, air=(float("nan"), 1000.0, 45.0)), "HC-T05"),
        (result(POINT, air=(0.0, 1013.25, 0.0)), "HC-T05"),
    ],
)
def test_a_bad_result_is_no_reading(tracker: Quick, bad: bytes, code: str) -> None:
    tracker.peer.answers[49] = lambda _: [reply(49), bad]
    error = measuring(tracker)
    assert kind(error) == (NoReading, code)
    assert len(str(error)) < 200


@pytest.mark.parametrize(("status", "code"), [(39, "HC-T04"), (26, "HC-T22"), (2, "HC-T23")])
def test_a_lost_initialisation_is_the_devices_failure(
    tracker: Quick, status: int, code: str
) -> None:
    tracker.peer.answers[49] = lambda _: [failure(49, status)]
    error = measuring(tracker)
    assert (type(error), error.code, error.fields) == (DeviceError, code, {"status": status})


def test_repeats_that_spread_are_no_reading(tracker: Quick) -> None:
    offsets = iter([-0.06, 0.06])
    tracker.peer.answers[49] = lambda _: [reply(49), result(POINT + [0, 0, next(offsets)])]
    assert measuring(tracker, 2).code == "HC-T15"


@pytest.mark.parametrize(
    ("unit", "unit_mm"),
    [("metres", 1e3), ("micrometres", 1e-3), ("feet", 304.8), ("yards", 914.4), ("inches", 25.4)],
)
def test_a_result_in_other_units_is_the_devices_failure_and_names_them(
    tracker: Quick, unit: str, unit_mm: float
) -> None:
    tracker.peer.answers[49] = lambda _: [reply(49), result(POINT / unit_mm)]
    error = measuring(tracker)
    assert (error.code, error.fields["unit"]) == ("HC-T18", unit)
    assert not isinstance(error, NoReading)
    assert f"in {unit}" in error.found


@pytest.mark.parametrize("monitor", [0, 1, 2])
def test_air_counts_as_measured_where_the_weather_monitor_corrects_by_it(
    bed: EmsconBed, monitor: int
) -> None:
    bed.peer.weather_monitor = monitor
    tracker = bed.connect()
    reading = tracker.measure(POINT, SMR, 1)
    assert reading.air == (Air(22.5, 1013.25, 45.0) if monitor == 2 else None)


def test_a_reflector_out_of_the_beam_is_searched(tracker: Quick) -> None:
    tracker.peer.xyz = tuple(POINT)
    tracker.peer.answers[55] = lambda _: [failure(55, 37)]
    tracker.measure(POINT, SMR, 1)
    assert tracker.peer.commands[-4:] == [55, 63, 49, 41]
    tracker.peer.answers[63] = lambda _: [failure(63, 10004)]
    error = measuring(tracker)
    assert isinstance(error, NoReading)
    assert "10004" in error.found
    assert "37" in error.found, "what was tried before"


def test_not_ready_is_searched_once(tracker: Quick) -> None:
    answers = iter([[failure(49, 10004)], [reply(49), result(POINT)]])
    tracker.peer.answers[49] = lambda _: next(answers)
    tracker.measure(POINT, SMR, 1)
    assert tracker.peer.commands[-5:] == [55, 49, 63, 49, 41]


def test_a_busy_server_is_asked_again(tracker: Quick) -> None:
    answers = iter([[failure(49, 1)], [failure(49, 1)], [reply(49), result(POINT)]])
    tracker.peer.answers[49] = lambda _: next(answers)
    np.testing.assert_array_equal(tracker.measure(POINT, SMR, 1).xyz_mm, POINT)
    tracker.peer.answers[49] = lambda _: [failure(49, 1)]
    with pytest.raises(NoReading):
        tracker.measure(POINT, SMR, 1)


@pytest.mark.parametrize(
    "data", [CLOSING, struct.pack("<II", 0, 8), struct.pack("<II", 2**31, 2), reply(40), None]
)
def test_a_lost_stream_is_the_devices_failure(tracker: Quick, data: bytes | None) -> None:
    if data is None:
        tracker.peer.server.drop()
    else:
        tracker.peer.answers[49] = lambda _: [data]
    assert not isinstance(measuring(tracker), NoReading)
    assert measuring(tracker).code == ("HC-T02" if data is None else "HC-T34")


@pytest.mark.parametrize(
    ("command", "answer", "code"),
    [
        (6, [reply(6, struct.pack("<5I", 0, 1, 0, 0, 0))], "HC-T06"),
        (27, [reply(27, struct.pack("<i", 1))], "HC-T06"),
        (42, [reflector(1, 3, "Prism")], "HC-T07"),
        (21, [reply(21, struct.pack("<3d", 21.0, 0.0, 40.0))], "HC-T05"),
        (1, [reply(1, bytes(12))], "HC-T02"),
        (1, [failure(1, 38)], "HC-T22"),
        (7, [reply(7)], "HC-T04"),  # it stays as it was
    ],
)
def test_a_wrong_tracker_is_refused(
    bed: EmsconBed, command: int, answer: list[bytes], code: str
) -> None:
    bed.peer.initialized = 3
    bed.peer.answers[command] = lambda _: answer
    assert refusal(bed.make().connect).code == code


def test_a_stop_gets_through_while_a_call_hangs(tracker: Quick) -> None:
    started = threading.Event()

    def hang(_body: bytes) -> list[bytes]:
        started.set()
        return [reply(49)]

    tracker.peer.answers[49] = hang
    with in_thread(lambda: tracker.measure(POINT, SMR, 1), DeviceError) as failures:
        started.wait()
        tracker.stop()
        tracker.peer.stopped.wait()
        tracker.time.silence(0.1)
    assert len(failures) == 1


def test_the_runs_stop_ends_a_measurement(tracker: Quick) -> None:

    def stop(_: bytes) -> list[bytes]:
        tracker.time.stop.set()
        return [reply(49)]

    tracker.peer.answers[49] = stop
    with pytest.raises(Stopped):
        tracker.measure(POINT, SMR, 1)


@pytest.mark.parametrize(("near", "samples"), [(POINT[:2], 1), (POINT * np.nan, 1), (POINT, 0)])
def test_nonsense_is_never_sent(tracker: Quick, near: Any, samples: int) -> None:
    before = len(tracker.peer.commands)
    with pytest.raises(DeviceError):
        tracker.measure(near, SMR, samples)
    assert len(tracker.peer.commands) == before


def test_a_dead_server_is_noticed_at_connect(bed: EmsconBed) -> None:
    silent = threading.Event()

    def serve(_: socket.socket) -> None:
        silent.wait()

    bed.time.silence(0.1)
    with Server(serve) as server:
        assert refusal(bed.make(port=server.port).connect).code == "HC-T02"
        silent.set()


def test_a_stop_that_is_refused_is_reported_beside_the_cause(tracker: Quick) -> None:
    tracker.peer.answers[49] = lambda _: [reply(49), NOT_READY]
    tracker.peer.answers[52] = lambda _: [failure(52, 10014)]
    error = measuring(tracker)
    assert isinstance(error, NoReading)
    assert "10014" in error.found


class TurningPeer:
    """Lets a peer turn over; ``stuck`` keeps its face, whatever it answers."""

    def __init__(self, peer: EmsconPeer, *, face: int = 1, stuck: bool = False) -> None:
        self.face, self.stuck = face, stuck
        self.seen: list[int] = []  # faces in which it measured
        measure = peer.answers[49]

        def measured(body: bytes) -> Sequence[bytes]:
            self.seen.append(self.face)
            return measure(body)

        peer.answers[49] = measured
        peer.answers[53] = self._turn
        peer.answers[98] = lambda _: [reply(98, struct.pack("<i", self.face))]

    def _turn(self, _: bytes) -> list[bytes]:
        self.face = self.face if self.stuck else 3 - self.face
        return [NOT_READY, reply(53)]


def test_a_nest_is_measured_in_the_second_face_and_the_tracker_left_in_the_first(
    tracker: Quick,
) -> None:
    turning = TurningPeer(tracker.peer)
    reading = tracker.measure_back(POINT, SMR, 3)
    tracker.measure(POINT, SMR, 1)
    assert turning.seen == [2, 2, 2, 1]
    assert turning.face == 1
    assert (reading.samples, reading.reflector) == (3, SMR)
    np.testing.assert_allclose(reading.xyz_mm, POINT)


@pytest.mark.parametrize(
    ("results", "code"),
    [
        ([NOT_READY], "HC-T10"),
        ([result(POINT + [0.0, off_mm, 0.0]) for off_mm in (-0.9, 0.9)], "HC-T15"),
    ],
    ids=["beam broken", "spread"],
)
def test_a_failure_in_the_second_face_leaves_the_tracker_in_the_first(
    tracker: Quick, results: list[bytes], code: str
) -> None:
    turning, answers = TurningPeer(tracker.peer), iter(results)
    tracker.peer.answers[49] = lambda _: [reply(49), next(answers)]
    error = refusal(lambda: tracker.measure_back(POINT, SMR, len(results)))
    assert (type(error), error.code, turning.face) == (NoReading, code, 1)


def test_a_face_that_reads_back_differently_is_refused(tracker: Quick) -> None:
    TurningPeer(tracker.peer, stuck=True)
    error = refusal(lambda: tracker.measure_back(POINT, SMR, 1))
    assert (error.code, error.fields["setting"], error.fields["written"]) == (
        "HC-T06",
        "face",
        (2,),
    )


@pytest.mark.parametrize("face", [1, 2])
def test_a_tracker_that_was_left_in_its_second_face_is_turned_back(
    bed: EmsconBed, face: int
) -> None:
    turning = TurningPeer(bed.peer, face=face)
    bed.connect()
    assert turning.face == 1
    assert bed.peer.commands.count(53) == face - 1


def test_a_controller_that_does_not_report_its_face_connects(bed: EmsconBed) -> None:
    bed.peer.answers[98] = lambda _: [failure(98, 2)]
    bed.connect()
    assert 53 not in bed.peer.commands


COMPENSATION, SERVER_STARTED = 11, 999
FRAME = [0.0] * 6
OTHERS = {  # what another program sets: the news of it, the command that reads it, its bytes
    "search": (4, 44, struct.pack("<di", 12.0, 10_000)),
    "units": (6, 6, struct.pack("<5I", 5, 0, 0, 0, 0)),
    "reflector": (7, 41, struct.pack("<i", 4)),
    "weather": (8, 48, struct.pack("<9i", 0, 0, 0, 0, 1, 0, 0, 0, 0)),
    "transforms": (8, 48, struct.pack("<9i", 2, 1, 0, 0, 1, 0, 0, 0, 0)),
    "axes": (12, 27, struct.pack("<i", 1)),
    "orientation": (15, 13, struct.pack("<6d", 0.1, *FRAME[1:])),
    "transformation": (16, 15, struct.pack("<7d", *FRAME, 1.0002)),
    "mode": (17, 25, struct.pack("<i", 1)),
    "stationary": (18, 29, struct.pack("<ii", 2000, 1)),
    "face": (31, 98, struct.pack("<i", 2)),
    "restarted": (SERVER_STARTED, 6, struct.pack("<5I", 0, 0, 0, 0, 0)),
}


def news(change: int) -> bytes:
    return struct.pack("<III", 12, 8, change)


@pytest.fixture
def telling(bed: EmsconBed) -> Quick:
    """Return a tracker whose controller reports its face."""
    bed.peer.settings[98] = struct.pack("<i", 1)
    return bed.connect(find_radius_mm=20.0)


def changed(error: DeviceError) -> bool:
    return error.code == "HC-T06" and not isinstance(error, NoReading | DeviceRefused)


@pytest.mark.parametrize("other", OTHERS)
@pytest.mark.parametrize("while_it", ["rests", "aims", "measures"])
def test_a_setting_of_another_program_is_refused_until_it_is_set_again(
    bed: EmsconBed, telling: Quick, other: str, while_it: str
) -> None:
    peer = bed.peer
    change, read, body = OTHERS[other]
    ours, go = peer.settings[read], peer.answers[55]

    def set_by_another() -> bytes:
        peer.settings[read] = body
        return news(change)

    if while_it == "rests":
        peer.server.send(set_by_another())
    if while_it == "aims":
        peer.answers[55] = lambda body: [set_by_another(), *go(body)]
    if while_it == "measures":
        peer.answers[49] = lambda _: [reply(49), set_by_another(), READY, result(peer.xyz)]
    assert changed(measuring(telling))
    peer.answers[49] = lambda _: [reply(49), READY, result(peer.xyz)]
    peer.answers[55] = go
    assert changed(measuring(telling)), "until a new connect"
    peer.settings[read] = ours
    telling.connect()
    assert telling.measure(POINT, SMR, 1).samples == 1


@pytest.mark.parametrize("command", [1, 6, 42, 98, 132])
def test_a_body_that_is_too_short_ends_the_connection(
    bed: EmsconBed, telling: Quick, command: int
) -> None:
    bed.peer.answers[command] = lambda _: [reply(command, bytes(3))]
    error = refusal(telling.connect)
    assert (error.code, error.operation) == ("HC-T02", "decode")
    assert "a reply of 3 bytes" in error.found


@pytest.mark.parametrize("other", OTHERS)
def test_news_of_a_setting_that_is_still_ours_costs_one_question_more(
    bed: EmsconBed, telling: Quick, other: str
) -> None:
    change, read, _ = OTHERS[other]
    telling.measure(POINT, SMR, 1)
    counts = [bed.peer.commands.count(read)]
    for data in (news(change), b""):
        bed.peer.server.send(data)
        telling.measure(POINT, SMR, 1)
        counts.append(bed.peer.commands.count(read))
    each = int(read == 41)  # the reflector is read after each reading
    assert np.diff(counts).tolist() == [each + 1, each]


def test_a_compensation_by_another_program_is_refused_until_a_new_connect(
    bed: EmsconBed, telling: Quick
) -> None:
    bed.peer.server.send(news(COMPENSATION))
    assert changed(measuring(telling))
    assert changed(measuring(telling))
    telling.connect()
    assert telling.measure(POINT, SMR, 1).samples == 1


@pytest.mark.parametrize("scale", [1.0002, 0.9999999, float("nan")])
def test_a_transformation_that_stretches_lengths_is_refused_while_it_is_in_use(
    bed: EmsconBed, scale: float
) -> None:
    bed.peer.settings[15] = struct.pack("<7d", *FRAME, scale)
    tracker = bed.connect()
    bed.peer.settings[48] = struct.pack("<9i", 2, 1, 0, 0, 1, 0, 0, 0, 0)
    error = refusal(tracker.connect)
    assert kind(error) == (DeviceRefused, "HC-T06")
    assert "scale" in error.found


@pytest.mark.parametrize("answer", [failure(48, 2), reply(48, status=2), reply(48)])
def test_an_older_controller_does_not_report_its_frame(bed: EmsconBed, answer: bytes) -> None:
    bed.peer.answers[48] = lambda _: [answer]
    del bed.peer.settings[13], bed.peer.settings[15]
    tracker = bed.connect()
    np.testing.assert_allclose(tracker.measure(POINT, SMR, 1).xyz_mm, POINT, atol=1e-6)


# -- a reflector that the beam follows -------------------------------------------------------------


def looks(xyz_mm: Any) -> bytes:
    """Return the answer to where the beam looks, at (3,) mm."""
    x, y, z = xyz_mm
    return reply(66, struct.pack("<2d", np.arctan2(y, x), np.arctan2(np.hypot(x, y), z)))


MOVED = POINT + [80.0, 600.0, -300.0]


@pytest.mark.parametrize(
    ("beam", "pointed"),
    [
        (looks(MOVED + [0.0, 0.0, 4.0]), False),  # 5 mm are searched
        (looks(MOVED + [0.0, 0.0, 6.0]), True),
        (looks(-MOVED), True),
        (looks([np.nan] * 3), True),
        (failure(66, 2), True),
    ],
    ids=["there", "beside", "behind", "nan", "unknown"],
)
def test_a_beam_that_has_followed_its_reflector_is_not_pointed(
    tracker: Quick, beam: bytes, pointed: bool
) -> None:
    peer = tracker.peer
    peer.answers[66] = lambda _: [beam]
    tracker.measure(POINT, SMR, 1)
    sent, peer.xyz = len(peer.commands), tuple(MOVED)
    np.testing.assert_array_equal(tracker.measure(MOVED, SMR, 1).xyz_mm, MOVED)
    assert peer.commands[sent:] == [66, *([55] if pointed else []), 49, 41]


def broken_beam(tracker: Quick) -> None:
    whole = tracker.peer.answers.pop(49)
    tracker.peer.answers[49] = lambda _: [reply(49), NOT_READY]
    assert refusal(lambda: tracker.measure(POINT, SMR, 1)).code == "HC-T10"
    tracker.peer.answers[49] = whole


def turned_over(tracker: Quick) -> None:
    TurningPeer(tracker.peer)
    tracker.measure_back(POINT, SMR, 1)


@pytest.mark.parametrize(
    "between",
    [
        broken_beam,
        lambda tracker: tracker.measure(POINT, "SMR 0.5in", 1),
        lambda tracker: tracker.release_beam(),
        turned_over,
        lambda tracker: tracker.connect(),
    ],
    ids=["failure", "other reflector", "released", "turned", "connected"],
)
def test_a_beam_that_may_have_left_its_reflector_is_pointed(tracker: Quick, between: Any) -> None:
    peer = tracker.peer
    peer.answers[66] = lambda _: [looks(POINT)]
    tracker.measure(POINT, SMR, 1)
    between(tracker)
    sent = len(peer.commands)
    tracker.measure(POINT, SMR, 1)
    assert 55 in peer.commands[sent:]


# -- a beam that a person aims, and a wider search ----------------------------------------------


def test_a_released_beam_is_measured_wherever_a_person_has_put_it(tracker: Quick) -> None:
    port: Aims = tracker
    peer, sent = tracker.peer, len(tracker.peer.commands)
    port.release_beam()
    peer.xyz = (-1500.0, 900.0, -1200.0)  # no one has told the tracker about this place
    reading = port.measure_aimed(SMR, 2)
    np.testing.assert_array_equal(reading.xyz_mm, peer.xyz)
    assert (reading.samples, reading.reflector) == (2, SMR)
    assert peer.commands[sent:] == [54, 49, 41, 49, 41]


@pytest.mark.parametrize(
    ("answer", "code"),
    [
        ([failure(49, 10004)], "HC-T11"),
        ([reply(49), NOT_READY], "HC-T10"),
        ([reply(49), result(POINT, std=0.051)], "HC-T15"),
        ([reply(49), result((float("nan"), 0, 0))], "HC-T14"),
    ],
)
def test_a_released_beam_on_no_reflector_is_no_reading_and_is_not_moved(
    tracker: Quick, answer: list[bytes], code: str
) -> None:
    tracker.peer.answers[49] = lambda _: answer
    sent = len(tracker.peer.commands)
    error = refusal(lambda: tracker.measure_aimed(SMR, 1))
    assert kind(error) == (NoReading, code)
    assert not {55, 58, 63, 135} & set(tracker.peer.commands[sent:])


@pytest.mark.parametrize("off_mm", [299.0, 301.0])
def test_a_wider_search_ends_with_the_radius_of_before(tracker: Quick, off_mm: float) -> None:
    peer, radii = tracker.peer, list[float]()
    keep = peer._set(43)

    def set_search(body: bytes) -> Sequence[bytes]:
        radii.append(struct.unpack("<di", body)[0])
        return keep(body)

    peer.answers[43] = set_search
    at = POINT + [0, off_mm, 0]
    peer.answers[49] = lambda _: [reply(49), READY, result(at)]
    if off_mm < 300.0:
        np.testing.assert_array_equal(tracker.search(POINT, SMR, 1, 300.0).xyz_mm, at)
    else:
        error = refusal(lambda: tracker.search(POINT, SMR, 1, 300.0))
        assert kind(error) == (NoReading, "HC-T16")
    assert radii == [300.0, 5.0]
    assert peer.settings[44] == struct.pack("<di", 5.0, 10_000)


@pytest.mark.parametrize("radius_mm", [0.0, -1.0, np.nan, np.inf])
def test_a_search_without_a_radius_is_refused(tracker: Quick, radius_mm: float) -> None:
    sent = len(tracker.peer.commands)
    assert refusal(lambda: tracker.search(POINT, SMR, 1, radius_mm)).code == "HC-T35"
    assert refusal(lambda: tracker.measure_aimed(SMR, 0)).code == "HC-T35"
    assert len(tracker.peer.commands) == sent


@pytest.mark.parametrize(
    ("angles", "beam"),
    [
        ((0.0, np.pi / 2), [1, 0, 0]),
        ((np.pi / 2, np.pi / 2), [0, 1, 0]),  # from x to y
        ((1.0, np.pi), [0, 0, -1]),  # V is zero at the zenith
        (None, None),  # a controller that does not tell
    ],
)
def test_a_failed_search_states_where_the_beam_looked(
    tracker: Quick, angles: tuple[float, float] | None, beam: list[float] | None
) -> None:
    peer = tracker.peer
    peer.answers[55] = lambda _: [NOT_READY, failure(55, 37)]
    peer.answers[63] = lambda _: [NOT_READY, failure(63, 37)]
    if angles is not None:
        peer.answers[66] = lambda _: [reply(66, struct.pack("<2d", *angles))]
    for searched_mm, search in (
        (5.0, lambda: tracker.measure(POINT, SMR, 1)),
        (300.0, lambda: tracker.search(POINT, SMR, 1, 300.0)),
    ):
        error = refusal(search)
        assert kind(error) == (NoReading, "HC-T11")
        if beam is None:
            assert "beam" not in error.fields
        else:
            assert error.fields["beam"] == pytest.approx(beam, abs=1e-12)
            assert error.fields["searched_mm"] == searched_mm


# -- what it reports before anything is written --------------------------------------------------

READING = {1, 13, 15, 21, 29, 31, 41, 42, 44, 48, 66, 98, 132}


def system_status(*, processor: int = 5, laser: int = 3, adm: int = 2) -> bytes:
    return struct.pack("<IIIIiiiIii", 0, processor, laser, adm, 3, 8, 900, 2, 0, 390793)


def info(*, adm: bool = True, sensor: int = 70, faces: int = 2) -> bytes:
    name = "AT401".encode("utf-16-le").ljust(64, b"\0")
    lengths_mm, angles = (0.0, 160_000.0, 500.0), (6.28, 3.14)
    return struct.pack(
        "<I64s5i3d2i2dI2i", sensor, name, 390793, 1, adm, 1, 1, *lengths_mm, 1000, faces, *angles,
        1, 3, 8,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("lie", "feature", "state", "needed"),
    [
        ({}, "serial number", "has", "mandatory"),
        ({}, "ADM (absolute distances)", "has", "mandatory"),
        ({}, "laser and ADM ready (warmed up)", "has", "mandatory"),
        ({1: system_status(laser=2)}, "laser and ADM ready (warmed up)", "has not", "mandatory"),
        ({1: system_status(adm=3)}, "laser and ADM ready (warmed up)", "has not", "mandatory"),
        ({1: system_status(processor=4)}, "initialised", "has not", "optional"),
        ({}, "weather station corrects distances", "has", "optional"),
        ({}, "reflector 'SMR 1.5in'", "has", "optional"),
        ({132: info(adm=False)}, "ADM (absolute distances)", "has not", "mandatory"),
        ({132: info(sensor=99)}, "sensor", "has not", "mandatory"),
        ({132: b""}, "type", "has not", "optional"),
        ({132: info(faces=1)}, "second face", "has not", "optional"),
        ({98: b""}, "second face", "has not", "optional"),
        ({31: b""}, "continuous time mode", "has not", "optional"),
        ({66: b""}, "GetDirection", "has not", "optional"),
        ({21: struct.pack("<3d", 0.0, 1013.0, 0.0)}, "values that air can have", "has not",
         "mandatory"),
    ],
)  # fmt: skip
def test_it_lists_its_abilities_and_changes_nothing(
    bed: EmsconBed, lie: dict[int, bytes], feature: str, state: str, needed: str
) -> None:
    bodies = {
        132: info(), 98: struct.pack("<i", 1), 66: struct.pack("<2d", 0, 1),
        31: struct.pack("<4i", 500, 0, 0, 0), 21: struct.pack("<3d", 21.0, 1010.0, 40.0),
    }  # fmt: skip
    for command, body in (bodies | lie).items():
        said = reply(command, body) if body else failure(command, 2)
        bed.peer.answers[command] = partial(lambda said, _: [said], said)
    inspects: Inspects = bed.make()
    found = {each.feature: each for each in inspects.inspect()}
    assert (found[feature].state, found[feature].needed) == (state, needed)
    assert found[feature].device == "Tracker"
    assert set(bed.peer.commands) <= READING


def test_a_cell_file_for_another_tracker_or_reflector_is_named_among_the_abilities(
    bed: EmsconBed,
) -> None:
    found = {each.feature: each for each in bed.make(serial="1", reflector="SMR 3in").inspect()}
    assert found["serial number"].state == found["reflector 'SMR 3in'"].state == "has not"
    assert "390793" in found["serial number"].note


def test_a_tracker_is_discovered_at_a_host_that_a_person_gave(bed: EmsconBed) -> None:
    known = {"host": "127.0.0.1", "port": bed.peer.server.port}
    discovers: type[Discovers] = LeicaEmsconTracker
    (found,) = discovers.discover(known)
    assert found.options == known | {"serial": "390793"}
    assert found.identities[0].serial == "390793"
    assert set(bed.peer.commands) <= READING
    assert discovers.discover({}) == []  # no network is searched
    bed.peer.answers[1] = lambda _: [b"HTTP/1.1 400 Bad Request"]
    assert discovers.discover(known) == []
