"""What a commissioning has announced, by its own words, and all that really moved beyond that.

A step's question says what moves, how far and how fast. The simulated cell records each motion with
the time at which it began, as journals do, so each belongs to the run of one step, and on the rail
to one jog.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

SLIDE = "slide"
AXES = [f"axis {n}" for n in range(1, 7)]
REST_MM, REST_DEG = 0.3, 1e-3  # play when the brake closes
AXIS_DEG = 0.02  # by which a controller overshoots a degree
FASTER = 1.06  # largest share of the announced speed
# Likewise in the step that proves scale and unit: there the shortest jog may have any speed.
UNPROVED, OF_UNPROVED, SHORTEST_MM = 1.2, "rail", 0.5
Event = dict[str, Any]
Limits = Mapping[str, tuple[float, float]]


def jog_bound_mm(distance_mm: float) -> float:
    """Return how far the slide goes at most (docs/commissioning.md)."""
    return 1.2 * abs(distance_mm) + 3.0


@dataclass(frozen=True)
class Motion:
    """One motion of the slide (mm) or of an axis (deg)."""

    began: str
    begin: float
    low: float
    high: float
    fastest: float


@dataclass(frozen=True)
class Bound:
    """How far (mm, deg) and how fast (mm/s, %) something may move; inf: as far as its limits."""

    far: float = 0.0
    fast: float = 0.0

    def of_speed(self, full: float) -> Bound:
        """Return a bound in percent of a full speed as one in its unit."""
        return Bound(self.far, self.fast * full / 100.0)


def announced(said: str) -> dict[str, tuple[Bound, Bound]]:
    """Return the bounds of slide and axes by step; nothing was announced for any other.

    A hall's robot stands at its safe pose before each step, and its homing method leaves the slide
    where it is: neither a way to the pose nor one to a reference is expected.
    """
    found = {}
    of_step = r"^step \d+ of \d+, (\S+): (.*?)(?=^step |\Z)"
    for step, words in re.findall(of_step, said, re.MULTILINE | re.DOTALL):
        _, _, moves = words.partition("it moves, in sequence:\n")
        moves, _, usual = moves.partition("where no speed is given: ")
        usual = usual.partition("\n")[0]
        motions = re.sub(r"\(needs .*?\)$", "", moves, flags=re.MULTILINE)
        clauses = re.split(r";|, then |\n", motions)
        clauses = [each for each in clauses if not re.search("reference|unless", each)]
        found[step] = (
            _bound(clauses, r"\bslide\b", "mm", r"([\d.]+) mm/s", usual),
            _bound(clauses, r"\b(?:robot|axis|axes)\b", "deg", r"([\d.]+) %", usual),
        )
    return found


def _bound(clauses: Sequence[str], device: str, unit: str, speed: str, usual: str) -> Bound:
    """Return the widest bound of the clauses about a device: "by 1 and 8 deg", "at 5 %"."""
    bounds = [Bound()]
    for clause in clauses:
        if re.search(device, clause):
            far = " ".join(re.findall(rf"\bby (?:at most )?([\d.,and ]+) {unit}", clause))
            fast = re.findall(speed, clause) or re.findall(speed, usual)
            bounds.append(
                Bound(
                    max(map(float, re.findall(r"\d[\d.]*", far)), default=math.inf),
                    max(map(float, fast)),
                )
            )
    return Bound(max(each.far for each in bounds), max(each.fast for each in bounds))


def unannounced(
    said: str, journals: Mapping[str, Sequence[Event]], travel: Mapping[str, Any], limits: Limits
) -> list[str]:
    """Return what moved beyond its bound, one line each; ``journals``: of the runs, by their names.

    ``limits`` has the ends of slide and axes, and ``AXES``' full speeds as ``axis N speed``.
    """
    moved, bounds = motions(travel), announced(said)
    problems = [*_outside(moved, journals)]
    by_step: dict[str, list[Sequence[Event]]] = {}
    for run, events in journals.items():
        by_step.setdefault(run.partition("-commission-")[2].rpartition("-")[0], []).append(events)
    for step, runs in by_step.items():
        slide, axes = bounds.get(step, (Bound(), Bound()))
        for name, each in moved.items():
            taken = [m for events in runs for m in within(each, events[0]["t"], events[-1]["t"])]
            bound = slide if name == SLIDE else axes.of_speed(limits[f"{name} speed"][1])
            share, least = FASTER, REST_MM if name == SLIDE else REST_DEG
            if step == OF_UNPROVED and name == SLIDE:
                share, least = UNPROVED, jog_bound_mm(SHORTEST_MM)
            found = _beyond(name, taken, Bound(bound.far, share * bound.fast), limits, least)
            problems += [f"{step}: {name} {words}" for words in found]
        for events in runs:
            problems += [f"{step}: {words}" for words in _jogs(moved[SLIDE], events)]
    return problems


def motions(travel: Mapping[str, Any]) -> dict[str, list[Motion]]:
    """Return the recorded motions of slide and axes."""
    found = {SLIDE: [_motion(each, "mm") for each in travel["slide"]["strokes"]]}
    for n, name in enumerate(AXES):
        found[name] = [_motion(each, "deg", n) for each in travel["axes"]["strokes"]]
    return found


def _motion(stroke: Mapping[str, Any], unit: str, axis: int | None = None) -> Motion:
    keys = [f"begin_{unit}", f"low_{unit}", f"high_{unit}", f"fastest_{unit}_s"]
    values = [stroke[key] if axis is None else stroke[key][axis] for key in keys]
    return Motion(stroke["began"], *values)


def within(moved: Sequence[Motion], since: str, until: str) -> list[Motion]:
    return [each for each in moved if since <= each.began <= until]


def excursion(moved: Sequence[Motion]) -> float:
    """Return the largest distance from where the first motion began."""
    if not moved:
        return 0.0
    begin = moved[0].begin
    return max(max(each.high - begin, begin - each.low) for each in moved)


def _outside(
    moved: Mapping[str, Sequence[Motion]], journals: Mapping[str, Sequence[Event]]
) -> Iterator[str]:
    spans = [(events[0]["t"], events[-1]["t"]) for events in journals.values()]
    for name, each in moved.items():
        alone = [m for m in each if not any(a <= m.began <= b for a, b in spans)]
        rest = REST_MM if name == SLIDE else REST_DEG
        if not excursion(alone) <= rest:
            yield f"without a run: {name} moved by {excursion(alone):.3f} at {alone[0].began}"


def _beyond(
    name: str, taken: Sequence[Motion], bound: Bound, limits: Limits, least: float
) -> Iterator[str]:
    """Judge the motions of a step by its bound; ``least``: a shorter one may have any speed."""
    rest = REST_MM if name == SLIDE else REST_DEG
    over = jog_bound_mm(bound.far) if name == SLIDE else bound.far + AXIS_DEG
    low, high = limits[name]
    if math.isinf(bound.far):
        for each in taken:
            if not low - rest <= each.low <= each.high <= high + rest:
                yield f"at {each.low:.3f} .. {each.high:.3f}, limits {low:g} .. {high:g}"
    elif not excursion(taken) <= (over if bound.far else rest):
        yield f"moved by {excursion(taken):.3f}, announced {bound.far:g}"
    fastest = max((each.fastest for each in taken if each.high - each.low > least), default=0.0)
    if not fastest <= bound.fast:
        yield f"moved at {fastest:.3f}, at most {bound.fast:.3f}"


def _jogs(slide: Sequence[Motion], events: Sequence[Event]) -> Iterator[str]:
    """Judge each jog by its own distance, from its intent to its record."""
    began = ""
    for event in events:
        if event.get("action") == "rail.jog":
            began = event["t"]
        elif event.get("what") == "slide jogged":
            moved_mm = excursion(within(slide, began, event["t"]))
            if not moved_mm <= jog_bound_mm(event["distance_mm"]):
                yield f"jog {event['key']} moved {moved_mm:.3f} mm of {event['distance_mm']:+g} mm"
