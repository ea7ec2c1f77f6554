"""kill -9 of the engine at any moment, then resume: no point lost, none measured twice.

A case is a calibration of the small cell that is killed `KILLS` times at random and resumed, held
against the same run uninterrupted. Beside them a short run is killed once at each of its records.
"""

from __future__ import annotations

import math
import random
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from campaigns.spread import print_table, progress, spread
from fakes.simulator import PaperCell
from hilcell.cell.file import load_cell
from tests.whole.bench import SMALL, Engine, command, events, judge, sets

COUNT = 50
KILLS = 10
SHORT = ("base-frame", SMALL | {"base_frame.points": "4"})  # connect, home, {W}, station, {B}
LONG = ("calibrate", SMALL | {"base_frame.points": "12", "layout.nest_samples": "10"})
LATER_S = 0.01  # a kill comes up to so much after its record: records are 2 to 20 ms apart

NOISE_MM = 0.2  # two samples, drawn twice
OF_ONE_STOP = ("control", "held", "touch")  # after a kill there are others

Event = dict[str, Any]


@dataclass(frozen=True)
class Killed:
    """A run that was killed and resumed until it ended."""

    kills: int
    acknowledged: list[str]  # keys of points, as the engines printed them
    journal: list[Event]


def points_of(printed: Sequence[Event]) -> list[str]:
    return [event["key"] for event in printed if event["kind"] == "point"]


def without_stops(printed: Sequence[Event]) -> set[str]:
    points = (event for event in printed if event["kind"] == "point")
    return {event["key"] for event in points if event["id"]["kind"] not in OF_ONE_STOP}


def killed(
    runs: Path, words: Sequence[str], moments: Sequence[int], *, later_s: Iterator[float]
) -> Killed:
    """Run, kill once each record of ``moments`` is printed and a while later, resume to the end."""
    acknowledged: list[str] = []
    name, kills = "", 0
    for moment in moments:
        again = ("resume", name) if name else ("run", *words)
        engine = Engine(*again, "--runs", runs)
        engine.until(partial(_reached, moment))
        time.sleep(next(later_s))
        acknowledged += points_of(engine.kill())
        name, kills = engine.run, kills + 1
    last = command("resume", name, "--runs", runs, "--json")
    acknowledged += points_of(events(last.stdout))
    journal = events(command("watch", name, "--runs", runs, "--json").stdout)
    return Killed(kills, acknowledged, journal)


def _reached(seq: int, event: Event) -> bool:
    return bool(event["seq"] >= seq)


def problems(found: Killed, whole: Sequence[Event]) -> list[str]:
    """Return what is not as in the uninterrupted run, in words."""
    end, kept = found.journal[-1], points_of(found.journal)
    if end["kind"] != "end" or end["state"] != "finished":
        return [f"the run did not finish: {end.get('state')} {end.get('reason')}"]
    said = [str(each) for each in judge(found.journal)]
    said += [f"{key} stands {n} times" for key, n in standing(found.journal).items() if n > 1]
    said += [f"{key} was acknowledged, and is lost" for key in set(found.acknowledged) - set(kept)]
    differ = without_stops(found.journal) ^ without_stops(whole)
    said += [f"{key} is in one of both runs" for key in sorted(differ)]
    again = measured_again(found.journal)
    if again > found.kills:  # at most the point in flight at each kill
        said.append(f"{again} points were measured again by {found.kills} kills")
    off_mm = moved_mm(found.journal, whole)
    said += [f"a point lies {each:.3f} mm off" for each in off_mm if not each <= NOISE_MM]
    return said + list(_figures_off(end["result"], whole[-1]["result"]))


def standing(journal: Sequence[Event]) -> Counter[str]:
    """Return how often each point stands; those that an event makes invalid do not."""
    counted = Counter[str]()
    for event in journal:
        if event["kind"] == "point" and not event.get("retaken"):
            counted[event["key"]] += 1
        for key in event.get("invalid", ()):
            counted[key] = 0
    return counted


def measured_again(journal: Sequence[Event]) -> int:
    """How many motions to a point were begun of which no point was journalled."""
    begun, journalled = Counter[str](), Counter[str]()
    for event in journal:
        begun[event.get("key", "")] += event.get("action") == "robot.move"
        journalled[event.get("key", "")] += event["kind"] == "point"
    return sum((begun - journalled).values())


def moved_mm(found: Sequence[Event], whole: Sequence[Event]) -> list[float]:
    """How far each point that both runs measured in one place lies from itself."""
    before = {event["key"]: event["xyz_mm"] for event in whole if event["kind"] == "point"}
    # A resume proves the hold by this nest, so that its later readings draw other noise.
    held = {e["id"]["nest"] for e in found if e["kind"] == "point" and e["id"]["kind"] == "held"}
    return [
        math.dist(event["xyz_mm"], before[event["key"]])
        for event in found
        if event["kind"] == "point"
        and event["key"] in before
        and event["id"].get("nest") not in held
        # Targets of the validation follow from the frames, and move with them.
        # All nests of a frame are measured by one engine.
        and not event["key"].startswith(("validate/", "control/", "touch/", "world/"))
    ]


def figures(result: dict[str, Any]) -> dict[str, float]:
    return {
        f"{where}.{label}": each[label]["mean"]
        for where, each in result.get("validation", {}).items()
        for label in ("before", "idw", "chosen")
    }


def _figures_off(result: dict[str, Any], whole: dict[str, Any]) -> Iterator[str]:
    found = figures(result)
    for key, value in figures(whole).items():
        # A point in flight at a kill is measured again, with new noise. One of a sweep turns the
        # base frame, one nest the station frame, and the paper's method scatters over 4 targets.
        near = key == "S1100.chosen"
        if not abs(found.get(key, math.nan) - value) <= (0.02 if near else 0.06):
            yield f"{key} is {found.get(key)}, uninterrupted {value}"


# -- the campaign ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """A killed run: what was wrong, and how it is repeated."""

    name: str
    kills: int
    points: int
    wrong: list[str]


def at_random(seed: int) -> Case:
    """Kill a calibration again and again, at random moments."""
    rng = random.Random(seed)
    later_s = iter(lambda: rng.uniform(0.0, LATER_S), None)
    whole = uninterrupted(*LONG, seed)
    moments = sorted(rng.sample(range(5, len(whole) - 5), KILLS))
    return judged(f"seed {seed}", *LONG, seed, whole, moments, later_s)


def at_record(record: int, whole: Sequence[Event]) -> Case:
    """Kill the short run once, as soon as a record is printed."""
    return judged(f"record {record}", *SHORT, 1, whole, [record], iter([0.0]))


@contextmanager
def machine(settings: dict[str, str], seed: int) -> Iterator[tuple[str, list[str]]]:
    """Yield a folder of runs, and the words of a run on a machine that outlives its engines."""
    with (
        closing(PaperCell(load_cell("paper", settings), seed=seed)) as simulated,
        tempfile.TemporaryDirectory(prefix="kills-") as runs,
    ):
        values = settings | {"simulation.address": simulated.address}
        yield runs, ["--seed", str(seed), *sets(values)]


def uninterrupted(procedure: str, settings: dict[str, str], seed: int) -> list[Event]:
    """Return the events of a run that nobody kills."""
    with machine(settings, seed) as (runs, words):
        return events(command("run", procedure, *words, "--runs", runs, "--json").stdout)


def judged(
    name: str,
    procedure: str,
    settings: dict[str, str],
    seed: int,
    whole: Sequence[Event],
    moments: Sequence[int],
    later_s: Iterator[float],
) -> Case:
    """Kill a run at moments and compare it with the whole one."""
    try:
        with machine(settings, seed) as (runs, words):
            found = killed(Path(runs), (procedure, *words), moments, later_s=later_s)
    except AssertionError as error:
        return Case(name, 0, 0, [f"a resumed engine ended: {error}"])
    return Case(name, found.kills, len(points_of(found.journal)), problems(found, whole))


def campaign(seeds: range) -> int:
    """Kill calibrations at random, and the short run at each of its records."""
    whole = uninterrupted(*SHORT, 1)
    records = [event["seq"] for event in whole[:-1]]
    each = list(_reported(spread(partial(at_record, whole=whole), records)))
    random_ones = list(_reported(spread(at_random, seeds)))
    return 0 if report({"at each record": each, "at random": random_ones}) else 1


def _reported(cases: Iterator[Case]) -> Iterator[Case]:
    for case in cases:
        progress(f"{case.name}: {case.kills} kills {'; '.join(case.wrong) or 'as uninterrupted'}")
        yield case


def report(kinds: dict[str, list[Case]]) -> bool:
    """Print the figures; return whether nothing was wrong."""
    head = ("kills", "runs", "kills", "points", "runs with something wrong")
    rows = [
        (name, len(cases), sum(c.kills for c in cases), sum(c.points for c in cases), _bad(cases))
        for name, cases in kinds.items()
    ]
    print_table(head, rows)
    for case in (case for cases in kinds.values() for case in cases):
        for text in case.wrong:
            print(f"WRONG {case.name}: {text}")
    return not any(_bad(cases) for cases in kinds.values())


def _bad(cases: list[Case]) -> int:
    return sum(bool(case.wrong) for case in cases)
