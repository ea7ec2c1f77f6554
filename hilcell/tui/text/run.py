"""The lines of the run's screen, as pure functions of the view and a width."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
from textual.content import Content

from hilcell.alarms.alarm import DRIFT_LIMIT_K
from hilcell.alarms.catalogue import SEVERITIES
from hilcell.clean import harmless
from hilcell.run.protocol import DeviceStatus
from hilcell.tui.engine.run_view import EngineState, RunView
from hilcell.tui.terminal.capabilities import Glyphs

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
    "silent": ("NO ANSWER", "fault"),
    "unreadable": ("UNREADABLE", "fault"),
    "gone": ("ENGINE GONE", "fault"),
}
NOT_E_STOP = "software stop; not the E-stop"
OF_RAIL = ("rail", "strip")  # lamps
NO_PLAN_TEXTS = {  # where there is no plan in the journal
    EngineState.UNKNOWN: "reading ...",
    EngineState.NONE: "nothing was recorded",
    EngineState.STARTING: "the engine starts ...",
    EngineState.ANSWERING: "nothing to see yet",
    EngineState.SILENT: "nothing to see yet",
}
SHORT = 4
MOST_OF_A_NAME = 20
LAMPS = (*OF_RAIL, "robot", "tracker")


def block(text: str, tone: str) -> Content:
    """Return a block of a tone: dark on light or light on dark, as the theme has it."""
    return Content.styled(f" {text} ", f"bold $on-{tone} on ${tone}-fill")


def badge(text: str) -> Content:
    """Return a quiet block: no state, but to be seen."""
    return Content.styled(f" {text} ", "bold $foreground on $badge")


def state_block(view: RunView, glyphs: Glyphs) -> Content:
    """Return element 1: the state by word, shape and colour."""
    word, tone = STATES[view.state]
    return block(f"{glyphs.states[view.state]} {word}", tone)


def banner(view: RunView, glyphs: Glyphs, width: int, background: RunView | None = None) -> Content:
    """Return the first line: state, LIVE or HISTORIC, SIMULATION, and a notice.

    ``background``: the live run that goes on while this one is shown.
    """
    parts = [state_block(view, glyphs)]
    if view.engine is not EngineState.UNKNOWN:
        parts += [Content(" "), badge("LIVE" if view.live else "HISTORIC")]
    if view.log.plan is not None and view.log.plan.simulated:
        parts += [Content(" "), block("SIMULATION", "sim")]
    left = Content("").join(parts)
    room = width - left.cell_length - 1
    return justified(
        left,
        _stop_notice(view, room) if background is None else _background_notice(background, room),
        width,
    )


def _stop_notice(view: RunView, room: int) -> Content:
    if view.state == "silent":
        since = f" for {short_age(view.status_age_s)}" if view.status is not None else ""
        return Content.styled(f"silent{since}: use the E-stop", "bold $fault")
    return Content.styled(NOT_E_STOP if room >= len(NOT_E_STOP) else "", "$label")


def _background_notice(background: RunView, room: int) -> Content:
    """Return the longest notice of the background run that fits."""
    word = STATES[background.state][0]
    stop = "use the E-stop" if background.state == "silent" else "Esc stops"
    notices = (f"behind: {word}; q goes back, {stop}", f"behind: {word}; {stop}", "1 behind")
    notice = next((each for each in notices if len(each) <= room), "")
    return Content.styled(notice, "bold $ask")


def end_text(view: RunView) -> str:
    """Return how a background run has ended."""
    worst = max(view.alarms, key=lambda alarm: SEVERITIES.index(alarm.severity), default=None)
    why = f": {worst.code} {worst.title}" if worst is not None else ""
    return f"the run behind, {view.run}, has ended: {STATES[view.state][0]}{why}"


def justified(left: Content, right: Content, width: int) -> Content:
    """Return a line with one text at each end; the right one yields where room is short."""
    room = width - left.cell_length - right.cell_length
    return left.append(" " * room).append(right) if room >= 1 else left


def identity(view: RunView, width: int) -> Content:
    """Return element 2: procedure, job, operator, run."""
    plan = view.log.plan
    if plan is None:
        begun = NO_PLAN_TEXTS[view.engine]
        return Content(f"run {view.run}: {view.trouble or begun}")
    cell = str(plan.cell.get("name", "?"))
    words = [plan.procedure, f"cell {cell}"]
    words += [f"job {short(plan.job)}"] if plan.job else []
    words += [f"operator {short(plan.operator)}"] if plan.operator else []
    words += ["unattended" if plan.unattended else "attended"]
    left = Content("  ".join(words))
    fits = left.cell_length + len(view.run) < width
    run = view.run if fits else f"run {view.run[-SHORT:]}"  # its last letters differ between runs
    return justified(left, Content.styled(run, "$label"), width)


def short(name: str) -> str:
    """Return a name that leaves room for others on its line."""
    return Content(name).truncate(MOST_OF_A_NAME, ellipsis=True).plain


def step(view: RunView, width: int) -> Content:
    """Return element 3: the current step with its count, and the next; in the end the bounds."""
    plan, now = view.log.plan, view.step
    if plan is None or not now:
        return Content.styled("step: none yet", "$label")
    number, of = int(now["number"]), int(now["of"])
    head = f"step {number}/{of} {now['name']}"
    planned = plan.steps[number - 1]["points"] if number <= len(plan.steps) else 0
    if planned:
        head += f": {min(len(view.measured.get(number, ())), planned)}/{planned}"
    elif sweeps := sweeps_of(plan.steps[number - 1 : number]):
        head += f": {min(len(view.log.streams), sweeps)}/{sweeps} sweeps"
    found = coverage(view)
    if found.plain:
        return justified(Content(head), found, width)
    if view.last is not None:
        place = f" at {view.last.station}" if view.last.station else ""
        head += f", last {view.last.key}{place}"
    if view.state in ("done", "intolerant"):
        return Content(head)
    following = plan.steps[number]["name"] if number < len(plan.steps) else "the end"
    return justified(Content(head), Content.styled(f"next: {following}", "$label"), width)


def sweeps_of(steps: Sequence[Mapping[str, Any]]) -> int:
    """Return how many axis sweeps the plan has for these steps."""
    spans = [span for step in steps for span in step.get("spans", ())]
    return sum(span["measured"] for span in spans if span["kind"] == "sweep")


def progress(view: RunView, glyphs: Glyphs, width: int) -> Content:
    """Return element 4: bar, elapsed, remaining."""
    share = share_done(view)
    left_s = view.remaining_s if view.live and view.state != "checking" else None
    left = "" if left_s is None else f"  left {duration(left_s)}"
    tail = f" {math.floor(100 * share):3d} %  elapsed {duration(view.elapsed_s)}{left}"
    room = max(width - len(tail), 1)
    done = math.floor(room * share)
    return Content.assemble(
        (glyphs.full * done, "$live"), (glyphs.empty * (room - done), "$label"), tail
    )


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


def lamps(view: RunView, glyphs: Glyphs, width: int) -> Content:
    """Return element 5 with 16: the lamps with the age of their readings, and the air."""
    devices = view.status.devices if view.status is not None and view.live else {}
    parts = [
        lamp(name, devices.get(name, DeviceStatus()), view, glyphs).append("  ")
        for name in lamps_of(view)
    ]
    return justified(Content("").join(parts), air(view, glyphs), width)


def lamps_of(view: RunView) -> tuple[str, ...]:
    """Return which lamps the run's cell has."""
    return LAMPS if view.has_rail else LAMPS[len(OF_RAIL) :]


def lamp(name: str, device: DeviceStatus, view: RunView, glyphs: Glyphs) -> Content:
    """Return one lamp; a stale reading is grey and shows its age."""
    title = name.capitalize()
    if device.age_s is None and device.state != "lost":
        return Content.styled(f"{glyphs.stale} {title} -", "$label")
    age_s = (device.age_s or 0.0) + view.status_age_s
    if device.state == "lost":
        return Content.styled(f"{glyphs.lost} {title} lost", "bold $fault")
    if device.state == "moving" and not view.stale:
        return Content.styled(f"{glyphs.moving} {title} moves", "$live")
    if device.state not in ("fresh", "moving") or view.stale or not age_s <= STALE_AFTER_S:
        return Content.styled(f"{glyphs.stale} {title} {short_age(age_s)}", "$label")
    return Content.styled(f"{glyphs.fresh} {title} {short_age(age_s)}", "$passed")


STALE_AFTER_S = 5.0


def short_age(seconds: float) -> str:
    """Return an age in at most five columns."""
    if not seconds < math.inf:
        return "?"
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    for size_s, unit in ((1, "s"), (60, "m"), (3600, "h")):
        if seconds / size_s < 99.5:
            return f"{seconds / size_s:.0f} {unit}"
    return f"{seconds / 86400:.0f} d"


def drift_k(view: RunView) -> float | None:
    """Return how far the air is from the run's first point, K."""
    celsius = view.log.temperatures_c()
    if view.last is None or view.last.temperature_c is None or not celsius:
        return None
    return view.last.temperature_c - celsius[0]


def air(view: RunView, glyphs: Glyphs) -> Content:
    """Return element 16: temperature and its drift since the first point."""
    drift = drift_k(view)
    if view.last is None:
        return Content("")
    if view.last.temperature_c is None or drift is None:
        return Content("air not measured")
    text = f"{view.last.temperature_c:.1f} C {glyphs.delta}{drift:+.1f} K"
    within = abs(drift) <= DRIFT_LIMIT_K
    return Content.styled(text if within else f"! {text}", "" if within else "bold $ask")


class _Mean(msgspec.Struct):
    mean: float


class _Bounds(msgspec.Struct):
    coverage: float
    mean_mm: float


class _Place(msgspec.Struct):
    before: _Mean
    chosen: _Mean
    bounds: _Bounds | None = None


def _validated(view: RunView) -> dict[str, _Place]:
    """Return the places of a finished validation; nothing of another procedure's result."""
    found = (view.log.end or {}).get("result", {}).get("validation", {})
    try:
        return msgspec.convert(found, dict[str, _Place])
    except msgspec.ValidationError:
        return {}


def coverage(view: RunView) -> Content:
    """Return the mean 95 % bound of corrected targets, and how many errors were inside theirs."""
    for name, place in _validated(view).items():
        if place.bounds is not None:
            bound, share = place.bounds.mean_mm, 100 * place.bounds.coverage
            return Content.styled(f"{name}: 95 % bound {bound:.3f} mm, {share:.0f} % in", "$label")
    return Content("")


def result(view: RunView, width: int) -> Content:
    """Return a finished run's main figures in one line, mean |e| before and after.

    Where it is out of tolerance, the worst place comes first.
    """
    places = _validated(view)
    bad = view.state == "intolerant"
    verdict = "out of tolerance" if bad else "in tolerance"
    line = f"{verdict}: mean |e| mm" if places else ""
    order = sorted(places, key=lambda name: -places[name].chosen.mean if bad else 0.0)
    for name in order:
        place = places[name]
        part = f"  {name} {place.before.mean:.3f} -> {place.chosen.mean:.3f}"
        if len(line) + len(part) <= width:  # the first places matter most
            line += part
    return Content(line or _judged(view)[:width])


def _judged(view: RunView) -> str:
    """Return a result that says itself in words; nothing of another procedure's."""
    result = (view.log.end or {}).get("result", {})
    found = result.get("recheck", result.get("targets"))
    text = found.get("text") if isinstance(found, dict) else None
    return harmless(text) if isinstance(text, str) else ""


def interlocks(view: RunView, width: int) -> Content:
    """Return element 15 in one line: the first thing that is blocked, and why."""
    if not view.live:
        return result(view, width)
    found = view.status.interlocks if view.status is not None else []
    blocked = [each for each in found if each.blocked]
    if not found:
        return Content.styled("interlocks: no reading", "$label")
    if view.stale:
        return Content.styled(
            f"interlocks: last heard {short_age(view.status_age_s)} ago", "$label"
        )
    if not blocked:
        return Content.styled(f"interlocks: {_free(view)}", "$label")
    line = f"{blocked[0].name} blocked: {blocked[0].blocked}"
    return Content(line).truncate(width, ellipsis=True)


def _free(view: RunView) -> str:
    """Return what may move while nothing is blocked; a person may stand in the cell."""
    if view.prompt is not None:
        return "nothing is blocked; nothing moves before the answer"
    if view.at_rest:
        return "nothing is blocked; nothing moves before one goes on"
    return "rail and robot may move" if view.has_rail else "the robot may move"


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
