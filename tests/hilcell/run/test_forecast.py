"""The forecast: exact where the plan is, honest where it is not, deaf to pauses."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from benchmarks.forecast import worst_after
from hilcell.journal.journal import Record
from hilcell.model.events import StreamRecorded
from hilcell.run.forecast import Forecast
from tests.hilcell.report.journals import plan_record

BEGAN = datetime(2026, 1, 1, tzinfo=UTC)
RECORDED = Path(__file__).with_name("forecast_run.jsonl")
KINDS = ("flange", "10 readings", "survey")

MEASURED = {
    "id": {"kind": "grid"},
    "reflector": "flange",
    "xyz_mm": [0.0, 0.0, 0.0],
    "std_mm": [0.0, 0.0, 0.0],
    "samples": 1,
    "session": 1,
    "frame": "tracker",
}
REST: dict[str, dict[str, Any]] = {  # of the records: all that a forecast does not read
    "plan": plan_record(),
    "point": MEASURED,
    "end": {"state": "finished", "exit": 0},
    "event": {"devices": [], "problems": {}, "station": "S", "key": "k"},
}


@dataclass
class Tape:
    """Writes a synthetic journal; ``now_s`` is the time on its clock."""

    forecast: Forecast = field(default_factory=Forecast)
    now_s: float = 0.0
    seq: int = 0
    session: int = 0

    @property
    def now(self) -> datetime:
        return BEGAN + timedelta(seconds=self.now_s)

    def write(self, kind: Any, **body: Any) -> None:
        self.seq += 1
        whole = REST.get(kind, {}) | body
        self.forecast.take(Record(self.seq, self.now.isoformat(), kind, "", whole))

    def pass_s(self, seconds: float) -> None:
        self.now_s += seconds

    def plan(self, steps: list[dict[str, Any]], speed: float | None, *, real: bool = False) -> None:
        self.write("plan", steps=steps, speed=speed, simulated=not real)

    def state(self, to: str) -> None:
        self.write("state", machine="run", to=to)

    def start(self) -> None:
        self.session += 1
        self.state("checking")
        self.state("running")

    def step(self, number: int) -> None:
        self.write("event", what="step", name="", number=number, of=9)

    def point(self, after_s: float, group: str = "g", **facts: Any) -> None:
        self.pass_s(after_s)
        self.write("point", group=group, station="S", **facts)

    @property
    def remaining_s(self) -> float | None:
        return self.forecast.remaining_s(self.now)

    @property
    def total_s(self) -> float:
        assert self.remaining_s is not None
        return self.forecast.elapsed_s(self.now) + self.remaining_s


def span(kind: str, measured: int, duration_s: float) -> dict[str, Any]:
    return {"kind": kind, "measured": measured, "duration_s": duration_s}


def step(name: str, points: int, duration_s: float, *spans: dict[str, Any]) -> dict[str, Any]:
    return {"name": name, "points": points, "duration_s": duration_s, "spans": list(spans)}


def test_a_plan_of_a_real_cell_is_believed_before_anything_happened() -> None:
    tape = Tape()
    tape.plan([step("home", 0, 30.0), step("grid", 10, 50.0)], None, real=True)
    assert tape.remaining_s == pytest.approx(80.0 + Forecast.CLOSING_S)


def test_nothing_is_predicted_without_a_plan_or_a_pace() -> None:
    tape = Tape()
    assert tape.remaining_s is None

    tape.plan([step("grid", 10, 50.0)], None)
    assert tape.remaining_s is None
    tape.start()
    tape.step(1)
    tape.point(5.0)
    assert tape.remaining_s is None  # the way to the first is not like the others
    tape.point(0.5)
    assert tape.remaining_s == pytest.approx(8 * 0.5 + Forecast.CLOSING_S)


def test_each_kind_learns_its_own_pace() -> None:
    tape = Tape()
    steps = [
        step("nests", 3, 15.0, span("nest", 3, 15.0)),
        step("grid", 100, 300.0, span("flange", 100, 300.0)),
        step("more nests", 100, 500.0, span("nest", 100, 500.0)),
    ]
    tape.plan(steps, None)
    tape.start()
    tape.step(1)
    for _ in range(3):
        tape.point(0.010)
    tape.step(2)
    tape.point(0.5)
    for _ in range(49):
        tape.point(0.030)
    assert tape.remaining_s == pytest.approx(50 * 0.030 + 100 * 0.010 + Forecast.CLOSING_S)


def test_a_sweep_that_was_recorded_is_one_of_its_step() -> None:
    stream = StreamRecorded(
        key="sweep/axis1/up", file="1.npy", sha256="", samples=9, joint_samples=9,
        first_device_s=0.0, last_device_s=1.0, longest_gap_s=0.1, form=1,
    )  # fmt: skip
    tape = Tape()
    tape.plan([step("sweeps", 5, 50.0, span("sweep", 5, 50.0))], None)
    tape.start()
    tape.step(1)
    for _ in range(3):
        tape.pass_s(2.0)
        tape.write("event", **msgspec.to_builtins(stream))
    assert tape.remaining_s == pytest.approx(2 * 2.0 + Forecast.CLOSING_S)


def test_spans_tell_unlike_points_of_one_step_apart() -> None:
    """Six long readings and then many short ones, at every station, with a way between them."""
    station = [span("leg", 0, 20.0), span("six", 6, 120.0), span("flange", 48, 144.0)]
    tape = Tape()
    tape.plan([step("frames", 162, 852.0, *station * 3)], 10.0)
    tape.start()
    tape.step(1)
    totals = []
    for _ in range(3):
        tape.pass_s(2.0)
        for each_s, count in ((2.0, 6), (0.3, 48)):
            for _ in range(count):
                tape.point(each_s)
                totals.append(tape.total_s)
    assert totals == pytest.approx([85.2 + Forecast.CLOSING_S] * len(totals))


def test_control_points_count_where_spans_know_of_them_and_nowhere_else() -> None:
    spans = [span("nest", 3, 30.0), span("nest", 2, 20.0)]
    for steps, left_s in (([step("frames", 2, 50.0, *spans)], 20.0), ([step("g", 5, 50.0)], 40.0)):
        tape = Tape()
        tape.plan(steps, None, real=True)
        tape.start()
        tape.step(1)
        for _ in range(3):
            tape.point(10.0, group="control")
        assert tape.remaining_s == pytest.approx(left_s + Forecast.CLOSING_S)


def test_proofs_of_nests_between_targets_are_no_targets() -> None:
    """They are planned after the targets, and are made within many of them, or not at all."""
    spans = [span("leg", 0, 5.0), span("flange", 5, 5.0), span("3 readings", 2, 6.0)]
    tape = Tape()
    tape.plan([step("validate", 10, 32.0, *spans, *spans)], None, real=True)
    tape.start()
    tape.step(1)
    counts = []
    for group in ("b", "b", "b", "control", "control", "b", "b", "i", "i", "control", "i"):
        joints = {} if group == "control" else {"commanded_deg": [0.0] * 6}
        tape.point(1.0, group=group, **joints)
        counts.append(tape.forecast.span)
    taken = [found and found[0] for found in counts]
    assert taken == [1, 2, 3, 3, 3, 4, 5, 1, 2, 2, 3]
    assert {found and found[1] for found in counts} == {5}
    ahead = [(each.kind, each.measured) for each in tape.forecast.ahead(tape.now)]
    assert ahead == [("flange", 2), ("3 readings", 1)]


def test_more_points_than_planned_and_points_measured_again_do_no_harm() -> None:
    tape = Tape()
    tape.plan([step("grid", 3, 9.0), step("empty", 0, 0.0), step("last", 0, 5.0)], None, real=True)
    tape.start()
    tape.step(1)
    tape.point(3.0)
    tape.point(40.0, retaken=True)
    assert tape.remaining_s == pytest.approx(2 * 3.0 + 5.0 + Forecast.CLOSING_S)
    for _ in range(7):
        tape.point(3.0)
    assert tape.remaining_s == pytest.approx(5.0 + Forecast.CLOSING_S)


def test_a_pause_counts_for_nothing() -> None:
    tape = Tape()
    tape.plan([step("grid", 10, 30.0)], None, real=True)
    tape.start()
    tape.step(1)
    for _ in range(4):
        tape.point(3.0)
    for state in ("paused", "suspended"):
        before = tape.forecast.elapsed_s(tape.now), tape.remaining_s
        tape.state(state)
        tape.pass_s(1000.0)
        assert (tape.forecast.elapsed_s(tape.now), tape.remaining_s) == pytest.approx(before)
        tape.state("running")
        tape.point(3.0)
    assert tape.total_s == pytest.approx(30.0 + Forecast.CLOSING_S)


@pytest.mark.parametrize("ends", [["stopping", "aborted"], ["faulted"], []])
def test_the_time_between_two_sessions_counts_for_nothing(ends: list[str]) -> None:
    tape = Tape()
    tape.plan([step("home", 0, 6.0), step("grid", 10, 30.0)], None, real=True)
    tape.start()
    tape.step(1)
    tape.pass_s(6.0)
    tape.step(2)
    for _ in range(5):
        tape.point(3.0)
    for state in ends:
        tape.state(state)
    tape.pass_s(9000.0)
    tape.write("end", state="running")  # a session that did not come to checking
    tape.pass_s(9000.0)
    tape.start()
    tape.step(1)
    assert tape.total_s == pytest.approx(36.0 + Forecast.CLOSING_S)
    tape.pass_s(4.0)  # the reference is found again
    tape.step(2)
    for _ in range(5):
        tape.point(3.0)
    assert tape.remaining_s == pytest.approx(Forecast.CLOSING_S)
    assert tape.forecast.elapsed_s(tape.now) == pytest.approx(40.0)


seconds = st.integers(0, 100_000_000).map(lambda us: us / 1e6)
plans = st.lists(
    st.lists(st.tuples(st.sampled_from(KINDS), st.integers(0, 5), seconds), max_size=4),
    min_size=1,
    max_size=5,
)


def planned(spans: list[tuple[str, int, float]]) -> dict[str, Any]:
    tables = [span(*each) for each in spans]
    points = sum(measured for _, measured, _ in spans)
    return step("s", points, sum(duration_s for *_, duration_s in spans), *tables)


@given(
    plan=plans,
    speed=st.none() | st.floats(0.1, 1000.0),
    real=st.booleans(),
    acts=st.lists(
        st.tuples(
            st.sampled_from(["point", "retake", "control", "step", "pause", "crash", "refused"]),
            seconds,
        ),
        max_size=60,
    ),
)
def test_whatever_happens_the_forecast_is_a_time(
    plan: list[list[tuple[str, int, float]]],
    speed: float | None,
    real: bool,
    acts: list[tuple[str, float]],
) -> None:
    tape = Tape()
    tape.plan([planned(spans) for spans in plan], speed, real=real)
    tape.start()
    number, worked_s = 0, 0.0
    for act, passed_s in acts:
        tape.pass_s(passed_s)
        worked_s += passed_s
        if act == "step":
            number += 1
            tape.step(number)
        elif act == "pause":
            tape.state("paused")
            tape.pass_s(passed_s)
            tape.state("running")
        elif act in ("crash", "refused"):
            worked_s -= passed_s
            if act == "refused":
                tape.write("end", state="running")
            tape.start()
            number = 0
        else:
            tape.write("point", group=act, station="S", retaken=act == "retake")
        check_sound(tape, worked_s)


def check_sound(tape: Tape, worked_s: float) -> None:
    """Elapsed is what was worked, the rest no less than nothing and never growing by itself."""
    now = tape.now
    assert tape.forecast.elapsed_s(now) == pytest.approx(worked_s, abs=1e-3)
    rests = [
        tape.forecast.remaining_s(now + timedelta(seconds=each)) for each in (-5.0, 0.0, 0.5, 60.0)
    ]
    if rests[0] is None:
        assert rests == [None] * 4
        return
    known = [rest for rest in rests if rest is not None]
    assert len(known) == 4
    assert all(math.isfinite(rest) and rest >= -1e-9 for rest in known)
    assert known == sorted(known, reverse=True)


@given(
    plan=plans,
    speed=st.floats(1.0, 1000.0),
    extra_s=st.fixed_dictionaries({kind: st.floats(0.0, 0.05) for kind in KINDS}),
)
def test_where_the_plan_is_proportionate_the_total_is_exact_once_each_kind_was_seen_twice(
    plan: list[list[tuple[str, int, float]]], speed: float, extra_s: dict[str, float]
) -> None:
    warm_up = [(kind, 3, 3.0) for kind in KINDS]
    # A lead's share of what comes on top is only guessed, so here none takes time.
    plan = [warm_up, *([(k, n, s if n else 0.0) for k, n, s in spans] for spans in plan)]
    tape = Tape()
    tape.plan([planned(spans) for spans in plan], speed)
    tape.start()
    totals = []
    for number, spans in enumerate(plan, start=1):
        tape.step(number)
        for kind, measured, duration_s in spans:
            for _ in range(measured):
                tape.point(duration_s / measured / speed + extra_s[kind])
                totals += [tape.total_s] * (number > 1)
    assert totals == pytest.approx([tape.now_s + Forecast.CLOSING_S] * len(totals), abs=1e-3)


@pytest.fixture
def recorded() -> list[Record]:
    """Return a small calibration at speed 10, paused once, as its journal held it.

    Bodies are cut down to what a forecast reads.
    """
    lines = RECORDED.read_bytes().splitlines()
    found = [msgspec.json.decode(line, type=Record) for line in lines]
    return [replace(record, body=REST.get(record.kind, {}) | record.body) for record in found]


def test_a_recorded_run_is_predicted_within_five_percent_after_a_tenth(
    recorded: list[Record],
) -> None:
    assert abs(worst_after(0.1, recorded)) <= 0.05
    assert abs(worst_after(0.5, recorded)) <= 0.025


def test_a_recorded_run_is_predicted_worse_with_a_plan_out_of_proportion(
    recorded: list[Record],
) -> None:
    for step_ in recorded[0].body["steps"]:
        for span_ in step_["spans"]:
            span_["duration_s"] *= 3.0 if step_["name"] == "validate" else 1.0
    assert abs(worst_after(0.1, recorded)) > 0.2
