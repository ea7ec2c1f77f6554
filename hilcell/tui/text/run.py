"""Rows 1 to 4 of the run's screen: state, run, step and progress; pure functions of the view."""

from __future__ import annotations

import math
from collections.abc import Sequence

from textual.content import Content

from hilcell.alarms.catalogue import SEVERITIES
from hilcell.journal.calibration_facts import run_judged, run_outcome
from hilcell.journal.runs import short_run
from hilcell.journal.times import local_words
from hilcell.journal.words import procedure_words, step_words
from hilcell.model.outcome import Outcome
from hilcell.model.plan import Step
from hilcell.model.point import CONTROL
from hilcell.tui.engine.run_view import EngineState, RunView
from hilcell.tui.layout import BLANK, Bar, Cell, Col, Fitting, Grid, Lines, ends
from hilcell.tui.terminal.capabilities import Glyphs
from hilcell.tui.text.devices import short_age

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
    words = run_outcome(view.log).partition(";")[0]
    return words.upper(), "ask" if run_judged(view.log) is Outcome.UNDECIDED else "fault"


def role_of(view: RunView) -> str:
    """Return the role of the state's colour; RUNNING is not bright where nothing is heard."""
    role = state_of(view)[1]
    return "label" if role == "live" and view.stale else role


def state_block(view: RunView, glyphs: Glyphs) -> Content:
    """Return the state by word, shape and colour."""
    return block(f"{glyphs.states[view.state]} {state_of(view)[0]}", role_of(view))


def banner(view: RunView, glyphs: Glyphs, background: RunView | None = None) -> Lines:
    """Return the first row: state, LIVE or HISTORIC, SIMULATION, and a notice; trouble fills it.

    ``background``: the live run that goes on while this one is shown.
    """
    tone = role_of(view)
    ground = f"bold $on-{tone} on ${tone}-fill" if tone in LOUD else ""
    parts = [state_block(view, glyphs)]
    if view.engine is not EngineState.UNKNOWN and background is None:
        parts.append(badge("LIVE" if view.live else "HISTORIC"))
    if is_simulated(view):
        parts.append(simulation_block())
    notices, style = _notices(view, background), "$label"
    if background is not None or view.state == "silent":
        style = "bold $fault" if background is None else "bold $ask"
    notice = Fitting(tuple(Content.styled(f"{each} ", ground or style) for each in notices))
    left = Content(" ").join(parts)
    return Grid([(left, notice)], Col(), Col(right=True, grows=True), styles={0: ground})


def is_simulated(view: RunView) -> bool:
    """Whether the run's cell is a simulated one."""
    return view.log.plan is not None and view.log.plan.simulated


def _notices(view: RunView, background: RunView | None) -> tuple[str, ...]:
    """Return the notices beside the state, the longest first."""
    if background is not None:
        word = state_of(background)[0]
        stop = "use the E-stop" if background.state == "silent" else "Esc stops"
        return f"behind: {word}; q goes back, {stop}", f"behind: {word}; {stop}", "1 behind"
    if view.state == "silent":
        since = f" for {short_age(view.status_age_s)}" if view.status is not None else ""
        return f"silent{since}: use the E-stop", "use the E-stop"
    return (NOT_E_STOP if view.live or view.state == "looking" else "nothing is connected",)


def end_text(view: RunView) -> str:
    """Return how a background run has ended."""
    worst = max(view.alarms, key=lambda alarm: SEVERITIES.index(alarm.severity), default=None)
    why = f": {worst.code} {worst.title}" if worst is not None else ""
    return f"the run behind, {view.run}, has ended: {state_of(view)[0]}{why}"


def identity(view: RunView) -> Lines:
    """Return procedure, cell, job, operator and run."""
    plan = view.log.plan
    if plan is None:
        begun = NO_PLAN_TEXTS[view.engine]
        return ends(f"run {view.run}: {view.trouble or begun}", "")
    names = {"cell": str(plan.cell.get("name", "?")), "job": plan.job, "operator": plan.operator}
    parts = [Content.styled(procedure_words(plan.procedure), "bold")]
    parts += [_labelled(name, text, 20) for name, text in names.items() if text]
    parts.append(Content.styled("unattended" if plan.unattended else "attended", "$label"))
    return ends(Content("   ").join(parts), _labelled("run", short_run(view.run), 14))


def _labelled(name: str, value: str, most: int) -> Content:
    """Return a value of so many columns at most, which leaves room for others on its line."""
    return Content.assemble((f"{name} ", "$label"), Content(value).truncate(most, ellipsis=True))


def step(view: RunView) -> Lines:
    """Return the current step in words, and how many of its part are measured."""
    plan, now = view.log.plan, view.step
    if plan is None or not now:
        return ends(("no step yet", "$label"), "")
    number, of = now.number, now.of
    name = step_words(now.name, has_rail=view.has_rail)
    over = view.state in ("done", "intolerant")
    words = "finished" if over else _part(view)
    taken, planned = _of_step(view, number)
    if over:
        planned = plan.points
        taken = min(sum(map(len, view.measured.values())), planned)
    head = Content.assemble(
        (f"Step {number} of {of}  ", "$label"), (name, "bold"), f": {words}" if words else ""
    )
    return ends(head, (f"{taken} of {planned}" if planned else "", "bold"))


def _part(view: RunView) -> str:
    """Return the part of the step under way, by its last point; "" where the count is of others."""
    if view.last is None or (view.newest_is_old and view.last is view.newest):
        return ""
    of_nests = view.span is not None and view.span.of_nests
    return "" if view.last.id.group == CONTROL and not of_nests else view.last.id.part


def _of_step(view: RunView, number: int) -> tuple[int, int]:
    """Return how many of the part under way are measured, and planned; of the step else."""
    if view.span is not None:
        return view.span.taken, view.span.planned
    steps = view.log.plan.steps if view.log.plan is not None else []
    planned = steps[number - 1].points if number <= len(steps) else 0
    if not planned and (sweeps := sweeps_of(steps[number - 1 : number])):
        return min(len(view.log.streams), sweeps), sweeps
    return min(len(view.measured.get(number, ())), planned), planned


def sweeps_of(steps: Sequence[Step]) -> int:
    """Return how many axis sweeps the plan has for these steps."""
    spans = [span for step in steps for span in step.spans]
    return sum(span.measured for span in spans if span.kind == "sweep")


def progress(view: RunView) -> Lines:
    """Return the bar in the state's colour, the time worked, and the time left or of the end."""
    tone = role_of(view)
    calm = not view.live and tone != "passed"
    done = Bar(share_done(view), "$label" if calm else f"${tone}-fill")
    # A point that is re-measured is beyond the plan, which has nothing left.
    known = bool(view.remaining_s) and view.state != "checking"
    left = f"{duration(view.remaining_s or 0.0)} left" if known else ""
    if not view.live:
        ended = bool(view.records) and view.log.end is not None
        left = f"at {local_words(view.records[-1].t)}" if ended else ""
    elif view.state == "suspended":
        left = "stands still"
    row: list[Cell] = [done, f"{duration(view.elapsed_s)} worked", (left, "bold")]
    bar = Col(8, grows=True, most=43)
    return Grid([row], bar, Col(16, right=True), Col(1, right=True, grows=True))


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
        return BLANK
    number = now.number
    words = "the end"
    if number < len(plan.steps):
        words = step_words(plan.steps[number].name, has_rail=view.has_rail)
    known = bool(view.ahead) and view.state == "running" and not view.stale
    left_s = sum(part.takes_s for part in view.ahead if part.step == number)
    when = f", in {duration(left_s)}" if known else ""
    return Content.styled(f"next: {words}{when}", "$label")


def moves(*, has_rail: bool) -> str:
    """Return the beginning of a sentence: robot and rail will move."""
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
