"""The actions of a screen: why one is refused now ("": it is not), and the footer with its keys.

At first no run is shown, and an engine that starts or does not answer takes no commands. A slot of
the footer keeps its place and its key, and is grey, not gone, where it would do nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from textual.content import Content

from hilcell.language import marked, tr

if TYPE_CHECKING:
    from hilcell.tui.run_view import RunView


POINTS, HISTORY = marked("only where the points are listed"), marked("only in the history")
STEPS = marked("only in commissioning")
ELSEWHERE = {  # actions of certain screens: the refusal on all others
    "bad": POINTS,
    "sort": POINTS,
    "retake": POINTS,
    "find": marked("only where there are rows to filter"),
    "mark": HISTORY,
    "compare": HISTORY,
    "again": STEPS,
    "onward": STEPS,
}
ONE_AT_A_TIME = marked("a run is live: stop, abort or detach from it first")
NOT_LIVE = marked("no run is live")
NO_ANSWER_REASONS = {
    "looking": marked("the run is being read"),
    "checking": marked("the engine starts"),
    "silent": marked("the engine does not answer"),
}
AT_REST = {
    "stopping": marked("the run is being stopped"),
    "done": marked("the run is over"),
} | NO_ANSWER_REASONS


def pause_command(view: RunView | None) -> str:
    """Return what the space bar does: pause, proceed, resume, or nothing."""
    if view is None or view.state in ("looking", "silent"):
        return ""
    if not view.live:
        over = view.state in ("done", "intolerant", "idle") and not view.calibration_lost
        return "" if over else "resume"
    if view.allows("pause"):
        return "pause"
    return "proceed" if view.allows("proceed") else ""


def refusal(name: str, view: RunView | None, *, background: bool, unacknowledged: bool) -> str:
    """Return why an action does nothing now.

    ``background``: another run is live in the background; ``unacknowledged``: alarms are.
    """
    live = view is not None and view.live
    match name:
        case "stop" | "detach":
            return "" if live or background else NOT_LIVE
        case "abort":
            if view is None or not live:
                return marked("go back to the live run first") if background else NOT_LIVE
            return no_answer_reason(view)
        case "new" | "commission" | "again" | "onward":
            return ONE_AT_A_TIME if live or background else ""
    acts, pages = ("pause", "retake", "acknowledge"), ("alarms", "interlocks", "log", "report")
    if name not in (*acts, *pages, "plots", "bad", "sort"):
        return ""
    if view is None or view.log.plan is None:
        return marked("no run is open")
    match name:
        case "retake":
            waits = no_answer_reason(view) if live else ONE_AT_A_TIME if background else ""
            return waits if view.log.points else marked("no point is measured yet")
        case "pause":
            return _pause_refusal(view, background=background)
        case "acknowledge":
            return "" if unacknowledged else marked("every alarm is acknowledged")
    return ""


def no_answer_reason(view: RunView) -> str:
    return "" if view.answers else NO_ANSWER_REASONS.get(view.state, NO_ANSWER_REASONS["silent"])


def _pause_refusal(view: RunView, *, background: bool) -> str:
    command = pause_command(view)
    if command == "resume" and background:
        return ONE_AT_A_TIME
    return "" if command else AT_REST.get(view.state, AT_REST["done"])


# By name: how wide the word of a slot may become.
ACTS = {"pause": 6, "abort": 5, "retake": 10, "acknowledge": 11, "detach": 7}
VIEWS = {
    "sort": 5, "bad": 3, "find": 5, "plots": 5, "interlocks": 5,
    "alarms": 6, "log": 4, "report": 6, "history": 4, "help": 4,
}  # fmt: skip
WORDS = marked(  # by label: shorter here
    {
        "worst first": "worst",
        "as measured": "order",
        "bad only": "bad",
        "filter": "find",
        "interlocks": "locks",
        "history": "runs",
    }
)
PALETTE_KEY, EVERY_ACTION = "^p", marked("every action")
# These stay, beside STOP, where there is no room for all.
NARROW = ("pause", "acknowledge", "alarms", "help")
FULL_WIDTH = 79


@dataclass(frozen=True, slots=True)
class FooterKey:
    """One slot as it is now: its key, its word, and whether it would do something."""

    key: str
    word: str
    works: bool

    def drawn(self, word: int = 0, pad: str = "") -> Content:
        """Return key and word, the word in a room of so many columns."""
        style = "bold $foreground on $badge" if self.works else "$stale"
        key, shown = f"{pad}{self.key}{pad}", f" {tr(self.word):<{word}}"
        return Content.assemble((key, style), (shown, "" if self.works else "$stale"))


def footer_lines(state: Callable[[str], FooterKey], width: int) -> Content:
    """Return both rows; ``state`` tells each action's key, word and whether it works."""
    stop = state("stop")
    style = "bold $background on $foreground" if stop.works else "bold $stale"
    first = Content.styled(f" {stop.key} {tr(stop.word)} ", style)
    if width < FULL_WIDTH:
        return first.append(_row(state, dict.fromkeys(NARROW, 0))).truncate(width)
    rows = first.append(" ").append(_row(state, ACTS, " ")), Content(" ").append(_row(state, VIEWS))
    return Content("\n").join(rows).truncate(2 * width)


def _row(state: Callable[[str], FooterKey], slots: Mapping[str, int], pad: str = "") -> Content:
    return Content(" ").join(state(name).drawn(word, pad) for name, word in slots.items())


def form_footer(acts: Sequence[FooterKey], views: Sequence[FooterKey], width: int) -> Content:
    """Return the two rows of a form: its own keys, then the actions from there."""
    rows = (
        Content("  ").join(each.drawn(pad=" ") for each in acts),
        Content(" ").join(each.drawn() for each in views),
    )
    return Content("\n").join(Content(" ").append(row).truncate(width) for row in rows)
