"""``python -m benchmarks.points [POINTS]``: one more point on the screen of a run that has many.

An update with one new record is applied and shown, in a run with 50 points and in one with 5000;
half of them are raw, half corrected targets, which are judged. Without the terminal's own drawing.
"""

from __future__ import annotations

import statistics
import time

from textual.pilot import Pilot

from benchmarks.words import parser
from hilcell.model.point import PointId
from hilcell.tui.app import RunUpdated
from hilcell.tui.run_view import EngineState
from hilcell.tui.session import RunUpdate
from tests.hilcell.tui.recording_app import RecordingApp, run_app, settle
from tests.hilcell.tui.sample_runs import SampleRun, measuring, status

FEW, MANY = 50, 5000
UPDATES = 40
SIZES = ((80, 24), (140, 45))


def with_points(count: int) -> SampleRun:
    """Return a run that goes on, with so many points."""
    story = measuring(count // 2)
    for _ in range(count - count // 2):
        measure(story)
    return story


def measure(story: SampleRun) -> None:
    number = len(story.records)
    id = PointId("validate", station="S1100", how="chosen", number=number)
    story.point(id, (1100.0, 0.1 * number, 400.0), (0.0, 0.1, 0.01))


def update_s(count: int, size: tuple[int, int]) -> float:
    """Return the median time, s, of an update with one point where ``count`` are known."""
    story, taken = with_points(count), list[float]()
    look = RunUpdate(list(story.records), EngineState.ANSWERING, status("running"))

    async def updates(app: RecordingApp, pilot: Pilot[int]) -> None:
        for _ in range(UPDATES):
            measure(story)
            heard = RunUpdate(story.records[-1:], EngineState.ANSWERING, status("running"))
            app.recorded.inbox.put(heard)
            began_s = time.perf_counter()
            app.on_run_updated(RunUpdated(app.recorded))
            taken.append(time.perf_counter() - began_s)
            await settle(pilot)

    run_app(updates, update=look, size=size)
    return statistics.median(taken)


def main() -> None:
    words = parser(__doc__)
    words.add_argument("points", type=int, nargs="?", default=MANY, metavar="POINTS")
    many = words.parse_args().points
    for size in SIZES:
        few_s, many_s = update_s(FEW, size), update_s(many, size)
        print(
            f"{size[0]}x{size[1]}: one more point at {many}: {1e3 * many_s:.1f} ms = "
            f"{many_s / few_s:.1f} x that at {FEW} ({1e3 * few_s:.1f} ms)"
        )


if __name__ == "__main__":
    main()
