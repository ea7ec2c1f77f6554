"""Rows 1 to 4 of the run's screen: state, run, step and progress; pure functions of the view."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

from textual.content import Content

from hilcell.alarms.catalogue import SEVERITIES
from hilcell.journal.calibration_facts import OUTCOMES, run_outcome
from hilcell.journal.point_id import CONTROL
from hilcell.journal.point_words import part_words, procedure_words, step_words
from hilcell.journal.runs import short_run
from hilcell.journal.times import local_words
from hilcell.tui.engine.run_view import EngineState, RunView
from hilcell.tui.terminal.capabilities import Glyphs
from hilcell.tui.text.devices import short_age
from hilcell.tui.text.lines import bar, justified, placed

STATES = {
    "looking": ("LOOKING", "label"),
    "idle": ("NOT STARTED", "label"),
    "checking": ("CHECKING", "label"),
    "running": ("RUNNING", "live"),
    "pausing": ("PAUSING", "ask"),
    "paused": ("PAUSED", "ask"),
    "suspended": ("ASKS YOU", "ask"),
    "stopping": ("STOPPING", "fault"),
    "done": ("DONE", "passed"),
    "intolerant": ("OUT OF TOLERANCE", "fault"),
    "aborted": ("ABORTED", "label"),
    "fault": ("FAULT", "fault"),
    "refused": ("REFUSED", "fault"),
    "silent": ("NO ANSWER", "fault"),
    "unreadable": ("UNREADABLE", "fault"),
    "gone": ("ENGINE GONE", "fault"),
}
LOUD = ("ask", "fault")  # roles whose states fill the first row
NOT_E_STOP = "software stop, not the E-stop"
NO_PLAN_TEXTS = {  # where there is no plan in the journal
    EngineState.UNKNOWN: "reading ...",
    EngineState.NONE: "nothing was recorded",
    EngineState.STARTING: "the engine starts ...",
    EngineState.ANSWERING: "nothing to see yet",
    EngineState.SILENT: "nothing to see yet",
}
MOST_OF_A_RUN = 14
GAP = 3  # between the parts of a row
BAR, BESIDE_BAR = 43, 36
ROOMY = 100  # columns for the badge beside a notice of the run behind
MOST_OF_A_NAME, LEAST_OF_A_NAME = 20, 8


def block(text: str, tone: str) -> Content:
    """Return a block of a role's fill."""
    return Content.styled(f" {text} ", f"bold $on-{tone} on ${tone}-fill")


def badge(text: str) -> Content:
    """Return a quiet block: no state, but to be seen."""
    return Content.styled(f" {text} ", "bold $foreground on $badge")


def simulation_block() -> Content:
    """Return the mark of a simulated run, in a colour that nothing else has."""
    edge = "$on-sim 60% on $sim-fill"
    return Content.assemble(("▒", edge), (" SIMULATION ", "bold $on-sim on $sim-fill"), ("▒", edge))


def state_of(view: RunView) -> tuple[str, str]:
    """Return the state's word and role: of a run that ended with exit 1, its outcome."""
    if view.state != "intolerant":
        return STATES[view.state]
    outcome = run_outcome(view.log).partition(";")[0]
    return outcome.upper(), "ask" if outcome == OUTCOMES["undecided"] else "fault"


def role_of(view: RunView) -> str:
    """Return the role of the state's colour; RUNNING is not bright where nothing is heard."""
    role = state_of(view)[1]
    return "label" if role == "live" and view.stale else role


def state_block(view: RunView, glyphs: Glyphs) -> Content:
    """Return the state by word, shape and colour."""
    return block(f"{glyphs.states[view.state]} {state_of(view)[0]}", role_of(view))


def banner(view: RunView, glyphs: Glyphs, width: int, background: RunView | None = None) -> Content:
    """Return the first row: state, LIVE or HISTORIC, SIMULATION, and a notice; trouble fills it.

    ``background``: the live run that goes on while this one is shown.
    """
    tone = role_of(view)
    ground = f"bold $on-{tone} on ${tone}-fill" if tone in LOUD else ""
    gap = Content.styled(" ", ground)
    left = state_block(view, glyphs)
    if view.engine is not EngineState.UNKNOWN and (background is None or width > ROOMY):
        left = Content("").join([left, gap, badge("LIVE" if view.live else "HISTORIC")])
    if is_simulated(view):
        left = Content("").join([left, gap, simulation_block()])
    room = width - left.cell_length - 2
    if background is None:
        notice, style = _stop_notice(view, room)
    else:
        notice, style = _background_notice(background, room), "bold $ask"
    rest = Content.styled(f"{notice:>{room}} ", ground or style) if room > 0 else Content("")
    return Content("").join([left, gap, rest])


def is_simulated(view: RunView) -> bool:
    """Whether the run's cell is a simulated one."""
    return view.log.plan is not None and view.log.plan.simulated


def _stop_notice(view: RunView, room: int) -> tuple[str, str]:
    """Return the notice beside the state, and its style on a calm row."""
    if view.state == "silent":
        since = f" for {short_age(view.status_age_s)}" if view.status is not None else ""
        return f"silent{since}: use the E-stop", "bold $fault"
    live = view.live or view.state == "looking"
    notice = NOT_E_STOP if live else "nothing is connected"
    return notice if room >= len(notice) else "", "$label"


def _background_notice(background: RunView, room: int) -> str:
    """Return the longest notice of the background run that fits."""
    word = state_of(background)[0]
    stop = "use the E-stop" if background.state == "silent" else "Esc stops"
    notices = (f"behind: {word}; q goes back, {stop}", f"behind: {word}; {stop}", "1 behind")
    return next((each for each in notices if len(each) <= room), "")


def end_text(view: RunView) -> str:
    """Return how a background run has ended."""
    worst = max(view.alarms, key=lambda alarm: SEVERITIES.index(alarm.severity), default=None)
    why = f": {worst.code} {worst.title}" if worst is not None else ""
    return f"the run behind, {view.run}, has ended: {state_of(view)[0]}{why}"


def identity(view: RunView, width: int) -> Content:
    """Return procedure, cell, job, operator and run, as many as there is room for."""
    plan = view.log.plan
    if plan is None:
        begun = NO_PLAN_TEXTS[view.engine]
        return Content(f" run {view.run}: {view.trouble or begun}").truncate(width, ellipsis=True)
    run = _labelled("run", short(short_run(view.run), MOST_OF_A_RUN))
    names = {"cell": str(plan.cell.get("name", "?")), "job": plan.job, "operator": plan.operator}
    attended = Content.styled("unattended" if plan.unattended else "attended", "$label")
    line = Content.assemble(" ", (procedure_words(plan.procedure), "bold"))
    room = width - line.cell_length - GAP - run.cell_length - 1
    for part in _fitting(names, attended, room):
        line = line.append(" " * GAP).append(part)
    return justified(line, run, width - 1)


def _fitting(names: Mapping[str, str], attended: Content, room: int) -> list[Content]:
    """Return the parts that fit: long names are shortened before one is left out."""
    for last, most in product(([attended], []), range(MOST_OF_A_NAME, LEAST_OF_A_NAME - 1, -1)):
        parts = [_labelled(name, short(text, most)) for name, text in names.items() if text]
        if _length(*parts, *last) <= room:
            return [*parts, *last]
    shown: list[Content] = []
    for part in parts:
        if _length(*shown, part) <= room:
            shown.append(part)
    return shown


def _length(*parts: Content) -> int:
    """Return the columns of parts with the gaps before them."""
    return sum(GAP + part.cell_length for part in parts)


def _labelled(name: str, value: str) -> Content:
    return Content.assemble((f"{name} ", "$label"), value)


def short(name: str, most: int = MOST_OF_A_NAME) -> str:
    """Return a name that leaves room for others on its line."""
    return Content(name).truncate(most, ellipsis=True).plain


def step(view: RunView, width: int) -> Content:
    """Return the current step in words, and how many of its part are measured."""
    plan, now = view.log.plan, view.step
    if plan is None or not now:
        return Content.styled(" no step yet", "$label")
    number, of = int(now["number"]), int(now["of"])
    name = step_words(str(now["name"]), has_rail=view.has_rail)
    head = Content.assemble((f" Step {number} of {of}  ", "$label"), (name, "bold"))
    if view.state in ("done", "intolerant"):
        return justified(head.append(": finished"), _counted(_planned(view)), width - 1)
    words = _part(view)
    head = head.append(f": {words}" if words else "")
    count = _counted(_of_step(view, number))
    room = width - 2 - count.cell_length if count.cell_length else width
    return justified(head.truncate(room, ellipsis=True), count, width - 1)


def _part(view: RunView) -> str:
    """Return the part of the step under way, by its last point; "" where the count is of others."""
    if view.last is None or (view.newest_is_old and view.last is view.newest):
        return ""
    of_nests = view.span is not None and view.span.of_nests
    return "" if view.last.id.group == CONTROL and not of_nests else part_words(view.last.id)


def _counted(found: tuple[int, int]) -> Content:
    return Content.styled(f"{found[0]} of {found[1]}" if found[1] else "", "bold")


def _planned(view: RunView) -> tuple[int, int]:
    planned = view.log.plan.points if view.log.plan is not None else 0
    return min(sum(map(len, view.measured.values())), planned), planned


def _of_step(view: RunView, number: int) -> tuple[int, int]:
    """Return how many of the part under way are measured, and planned; of the step else."""
    if view.span is not None:
        return view.span.taken, view.span.planned
    steps = view.log.plan.steps if view.log.plan is not None else []
    planned = steps[number - 1]["points"] if number <= len(steps) else 0
    if not planned and (sweeps := sweeps_of(steps[number - 1 : number])):
        return min(len(view.log.streams), sweeps), sweeps
    return min(len(view.measured.get(number, ())), planned), planned


def sweeps_of(steps: Sequence[Mapping[str, Any]]) -> int:
    """Return how many axis sweeps the plan has for these steps."""
    spans = [span for step in steps for span in step.get("spans", ())]
    return sum(span["measured"] for span in spans if span["kind"] == "sweep")


def progress(view: RunView, width: int) -> Content:
    """Return the bar in the state's colour, the time worked, and the time left or of the end."""
    tone = role_of(view)
    calm = not view.live and tone != "passed"
    style = "$label" if calm else f"${tone}-fill"
    worked = Content.styled(f"{duration(view.elapsed_s)} worked", "")
    left = Content.styled(_left(view), "bold")
    room = min(max(width - BESIDE_BAR, 8), BAR)
    line = Content(" ").append(bar(share_done(view), room, style))
    return justified(placed((0, line), (room + 18 - worked.cell_length, worked)), left, width - 1)


def _left(view: RunView) -> str:
    if not view.live:
        ended = bool(view.records) and view.log.end is not None
        return f"at {local_words(view.records[-1].t)}" if ended else ""
    if view.state == "suspended":
        return "stands still"
    # A point that is re-measured is beyond the plan, which has nothing left.
    known = bool(view.remaining_s) and view.state != "checking"
    return f"{duration(view.remaining_s or 0.0)} left" if known else ""


def share_done(view: RunView) -> float:
    """Return the share of the run that is done, by time where it is known, else by points."""
    if view.state in ("done", "intolerant"):
        return 1.0
    if view.remaining_s is not None and view.elapsed_s + view.remaining_s > 0:
        return view.elapsed_s / (view.elapsed_s + view.remaining_s)
    plan = view.log.plan
    if plan is None or not plan.points:
        return 0.0
    return min(len(view.log.points) / plan.points, 1.0)


def duration(seconds: float) -> str:
    """Return a duration as M:SS, or H:MM:SS."""
    if not math.isfinite(seconds):
        return "-:--"
    whole = max(round(seconds), 0)
    minutes, second = divmod(whole, 60)
    hours, minute = divmod(minutes, 60)
    return f"{hours}:{minute:02d}:{second:02d}" if hours else f"{minute}:{second:02d}"


def following(view: RunView) -> Content:
    """Return the next step and when it begins; nothing once the run is over."""
    plan, now = view.log.plan, view.step
    if plan is None or not now or not view.live:
        return Content("")
    number = int(now["number"])
    words = "the end"
    if number < len(plan.steps):
        words = step_words(plan.steps[number]["name"], has_rail=view.has_rail)
    known = bool(view.ahead) and view.state == "running" and not view.stale
    left_s = sum(part.takes_s for part in view.ahead if part.step == number)
    when = f", in {duration(left_s)}" if known else ""
    return Content.styled(f"next: {words}{when}", "$label")


def moves(*, has_rail: bool) -> str:
    """Return what will move, as the beginning of a sentence."""
    return "The robot and the rail will move" if has_rail else "The robot will move"


def resume_text(view: RunView | None) -> str:
    """Return what a resumed run will meet."""
    if view is not None and view.calibration_lost:
        return "Its calibration file is written; nothing moves."
    what = moves(has_rail=view is None or view.has_rail)
    if view is not None and any(alarm.ended for alarm in view.alarms):
        return f"{what}. Its fault wants a new run: resumed, it will most likely fault again."
    return (
        f"{what}: the devices are connected again, and the tracker's control points proved "
        "before anything counts."
    )
