"""The run in words: each line of the screen as a pure function of the scene and a width."""

from __future__ import annotations

import math

import msgspec
from textual.content import Content

from hilcell.alarms.alarm import DRIFT_LIMIT_K
from hilcell.alarms.catalogue import SEVERITIES
from hilcell.run.protocol import DeviceStatus
from hilcell.tui.engine.scene import EngineState, Scene
from hilcell.tui.terminal.capabilities import Glyphs

STATES = {
    "looking": ("LOOKING", "quiet"),
    "idle": ("NOT STARTED", "quiet"),
    "checking": ("CHECKING", "info"),
    "running": ("RUNNING", "good"),
    "pausing": ("PAUSING", "warn"),
    "paused": ("PAUSED", "warn"),
    "suspended": ("ASKS YOU", "warn"),
    "stopping": ("STOPPING", "bad"),
    "done": ("DONE", "good"),
    "intolerant": ("OUT OF TOLERANCE", "bad"),
    "aborted": ("ABORTED", "quiet"),
    "fault": ("FAULT", "bad"),
    "silent": ("NO ANSWER", "bad"),
    "unreadable": ("UNREADABLE", "bad"),
    "gone": ("ENGINE GONE", "bad"),
}
NOT_E_STOP = "software stop; not the E-stop"
MOVES = "The robot and the rail will move"
NOTHING = {  # where there is no plan in the journal
    EngineState.UNKNOWN: "reading ...",
    EngineState.NONE: "nothing was recorded",
    EngineState.STARTING: "the engine starts ...",
    EngineState.HEARD: "nothing to see yet",
    EngineState.SILENT: "nothing to see yet",
}
SHORT = 4
MOST_OF_A_NAME = 20
LAMPS = ("rail", "strip", "robot", "tracker")


def inverse(text: str, tone: str) -> Content:
    """Return a block of a tone: dark on light or light on dark, as the theme has it."""
    return Content.styled(f" {text} ", f"bold $on-{tone} on ${tone}")


def state_block(scene: Scene, glyphs: Glyphs) -> Content:
    """Return element 1: the state by word, shape and colour."""
    word, tone = STATES[scene.key]
    return inverse(f"{glyphs.states[scene.key]} {word}", tone)


def banner(scene: Scene, glyphs: Glyphs, width: int, behind: Scene | None = None) -> Content:
    """Return the first line: state, LIVE or HISTORIC, SIMULATION, and what the stop is not.

    ``behind``: the live run that was left to look at this one.
    """
    parts = [state_block(scene, glyphs)]
    if scene.engine is not EngineState.UNKNOWN:
        word, tone = ("LIVE", "info") if scene.live else ("HISTORIC", "quiet")
        parts += [Content(" "), inverse(word, tone)]
    if scene.log.plan is not None and scene.log.plan.simulated:
        parts += [Content(" "), inverse("SIMULATION", "sim")]
    left = Content("").join(parts)
    room = width - left.cell_length - 1
    return spread(left, _beside(scene, room) if behind is None else _told(behind, room), width)


def _beside(scene: Scene, room: int) -> Content:
    if scene.key == "silent":
        since = f" for {short_age(scene.heard_s)}" if scene.status is not None else ""
        return Content.styled(f"silent{since}: use the E-stop", "bold $bad")
    return Content.styled(NOT_E_STOP if room >= len(NOT_E_STOP) else "", "$dim")


def _told(behind: Scene, room: int) -> Content:
    """Say that a run goes on behind, in as many words as there is room for."""
    word = STATES[behind.key][0]
    stop = "use the E-stop" if behind.key == "silent" else "Esc stops"
    sayings = (f"behind: {word}; q goes back, {stop}", f"behind: {word}; {stop}", "1 behind")
    said = next((each for each in sayings if len(each) <= room), "")
    return Content.styled(said, "bold $warn")


def end_of(scene: Scene) -> str:
    """Say how a run has ended that went on behind another one."""
    worst = max(scene.alarms, key=lambda alarm: SEVERITIES.index(alarm.severity), default=None)
    why = f": {worst.code} {worst.title}" if worst is not None else ""
    return f"the run behind, {scene.run}, has ended: {STATES[scene.key][0]}{why}"


def spread(left: Content, right: Content, width: int) -> Content:
    """Return a line with one text at each end; the right one yields where both do not fit."""
    room = width - left.cell_length - right.cell_length
    return left.append(" " * room).append(right) if room >= 1 else left


def identity(scene: Scene, width: int) -> Content:
    """Return element 2: procedure, job, operator, run."""
    plan = scene.log.plan
    if plan is None:
        begun = NOTHING[scene.engine]
        return Content(f"run {scene.run}: {scene.trouble or begun}")
    cell = str(plan.cell.get("name", "?"))
    words = [plan.procedure, f"cell {cell}"]
    words += [f"job {short(plan.job)}"] if plan.job else []
    words += [f"operator {short(plan.operator)}"] if plan.operator else []
    words += ["unattended" if plan.unattended else "attended"]
    left = Content("  ".join(words))
    fits = left.cell_length + len(scene.run) < width
    run = scene.run if fits else f"run {scene.run[-SHORT:]}"  # its last letters tell runs apart
    return spread(left, Content.styled(run, "$dim"), width)


def short(name: str) -> str:
    """Return a name that leaves room for others on its line."""
    return Content(name).truncate(MOST_OF_A_NAME, ellipsis=True).plain


def step(scene: Scene, width: int) -> Content:
    """Return element 3: the current step with its count, and the next."""
    plan, now = scene.log.plan, scene.step
    if plan is None or not now:
        return Content.styled("step: none yet", "$dim")
    number, of = int(now["number"]), int(now["of"])
    head = f"step {number}/{of} {now['name']}"
    planned = plan.steps[number - 1]["points"] if number <= len(plan.steps) else 0
    if planned:
        head += f": {min(len(scene.measured.get(number, ())), planned)}/{planned}"
    if scene.last is not None:
        place = f" at {scene.last.station}" if scene.last.station else ""
        head += f", last {scene.last.key}{place}"
    if scene.key in ("done", "intolerant"):
        return Content(head)
    following = plan.steps[number]["name"] if number < len(plan.steps) else "the end"
    return spread(Content(head), Content.styled(f"next: {following}", "$dim"), width)


def progress(scene: Scene, glyphs: Glyphs, width: int) -> Content:
    """Return element 4: bar, elapsed, remaining."""
    share = share_done(scene)
    left_s = scene.remaining_s if scene.live and scene.key != "checking" else None
    left = "" if left_s is None else f"  left {duration(left_s)}"
    tail = f" {math.floor(100 * share):3d} %  elapsed {duration(scene.elapsed_s)}{left}"
    room = max(width - len(tail), 1)
    done = math.floor(room * share)
    return Content.assemble(
        (glyphs.full * done, "$info"), (glyphs.empty * (room - done), "$dim"), tail
    )


def share_done(scene: Scene) -> float:
    """Return the share of the run that is done, by time where it is known, else by points."""
    if scene.key in ("done", "intolerant"):
        return 1.0
    if scene.remaining_s is not None and scene.elapsed_s + scene.remaining_s > 0:
        return scene.elapsed_s / (scene.elapsed_s + scene.remaining_s)
    plan = scene.log.plan
    if plan is None or not plan.points:
        return 0.0
    return min(len(scene.log.points) / plan.points, 1.0)


def duration(seconds: float) -> str:
    """Return a duration as M:SS, or H:MM:SS."""
    if not math.isfinite(seconds):
        return "-:--"
    whole = max(round(seconds), 0)
    minutes, second = divmod(whole, 60)
    hours, minute = divmod(minutes, 60)
    return f"{hours}:{minute:02d}:{second:02d}" if hours else f"{minute}:{second:02d}"


def lamps(scene: Scene, glyphs: Glyphs, width: int) -> Content:
    """Return element 5 with 16: four lamps with the age of their readings, and the air."""
    devices = scene.status.devices if scene.status is not None and scene.live else {}
    parts = [
        lamp(name, devices.get(name, DeviceStatus()), scene, glyphs).append("  ") for name in LAMPS
    ]
    return spread(Content("").join(parts), air(scene, glyphs), width)


def lamp(name: str, device: DeviceStatus, scene: Scene, glyphs: Glyphs) -> Content:
    """Return one lamp; a stale reading is grey and says how old it is."""
    title = name.capitalize()
    if device.age_s is None and device.state != "lost":
        return Content.styled(f"{glyphs.stale} {title} -", "$dim")
    age_s = (device.age_s or 0.0) + scene.heard_s
    if device.state == "lost":
        return Content.styled(f"{glyphs.lost} {title} lost", "bold $bad")
    if device.state == "moving" and not scene.stale:
        return Content.styled(f"{glyphs.moving} {title} moves", "$info")
    if device.state not in ("fresh", "moving") or scene.stale or not age_s <= STALE_AFTER_S:
        return Content.styled(f"{glyphs.stale} {title} {short_age(age_s)}", "$dim")
    return Content.styled(f"{glyphs.fresh} {title} {short_age(age_s)}", "$good")


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


def drift_k(scene: Scene) -> float | None:
    """Return how far the air is from the run's first point, K."""
    points = scene.log.points
    if scene.last is None or not points:
        return None
    first = next(iter(points.values()))
    return scene.last.temperature_c - first.temperature_c


def air(scene: Scene, glyphs: Glyphs) -> Content:
    """Return element 16: temperature and its drift since the first point."""
    drift = drift_k(scene)
    if scene.last is None or drift is None:
        return Content("")
    text = f"{scene.last.temperature_c:.1f} C {glyphs.delta}{drift:+.1f} K"
    within = abs(drift) <= DRIFT_LIMIT_K
    return Content.styled(text if within else f"! {text}", "" if within else "bold $warn")


class _Mean(msgspec.Struct):
    mean: float


class _Place(msgspec.Struct):
    before: _Mean
    chosen: _Mean


def result(scene: Scene, width: int) -> Content:
    """Return a finished run's main figures in one line, mean |e| before and after.

    Where it is out of tolerance, the worst place stands first.
    """
    found = (scene.log.end or {}).get("result", {}).get("validation", {})
    try:
        places = msgspec.convert(found, dict[str, _Place])
    except msgspec.ValidationError:  # another procedure's result
        return Content("")
    bad = scene.key == "intolerant"
    verdict = "out of tolerance" if bad else "in tolerance"
    line = f"{verdict}: mean |e| mm" if places else ""
    order = sorted(places, key=lambda name: -places[name].chosen.mean if bad else 0.0)
    for name in order:
        place = places[name]
        part = f"  {name} {place.before.mean:.3f} -> {place.chosen.mean:.3f}"
        if len(line) + len(part) <= width:  # the first places say most
            line += part
    return Content(line)


def interlocks(scene: Scene, width: int) -> Content:
    """Return element 15 in one line: the first thing that is blocked, and why."""
    if not scene.live:
        return result(scene, width)
    found = scene.status.interlocks if scene.status is not None else []
    blocked = [each for each in found if each.blocked]
    if not found:
        return Content.styled("interlocks: no reading", "$dim")
    if scene.stale:
        return Content.styled(f"interlocks: last heard {short_age(scene.heard_s)} ago", "$dim")
    if not blocked:
        return Content.styled(f"interlocks: {_free(scene)}", "$dim")
    said = f"{blocked[0].name} blocked: {blocked[0].blocked}"
    return Content(said).truncate(width, ellipsis=True)


def _free(scene: Scene) -> str:
    """Return what may happen where nothing is blocked; a person may stand in the cell."""
    if scene.prompt is not None:
        return "nothing is blocked; nothing moves before the answer"
    if scene.at_rest:
        return "nothing is blocked; nothing moves before one goes on"
    return "rail and robot may move"


def prospect(scene: Scene | None) -> str:
    """Return what a resumed run will meet."""
    if scene is not None and scene.lost:
        return "Its calibration file is written; nothing moves."
    if scene is not None and any(alarm.ended for alarm in scene.alarms):
        return f"{MOVES}. Its fault wants a new run: resumed, it will most likely fault again."
    return (
        f"{MOVES}: the devices are connected again, and the tracker's control points proved "
        "before anything counts."
    )
