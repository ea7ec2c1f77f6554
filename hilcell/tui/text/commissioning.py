"""Commissioning as text: the steps with their status, the question, the checks of a step."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from textual.content import Content

from hilcell.commission.dialogue import Question
from hilcell.commission.record import Check
from hilcell.commission.sequence import STEPS
from hilcell.language import marked, tr
from hilcell.sanitize import harmless
from hilcell.tui.commissioning import Progress
from hilcell.tui.layout import BLANK, Col, Fitting, Grid, Lines, Stack, Text, labelled_rows, section
from hilcell.tui.terminal import Glyphs
from hilcell.tui.text.run import NOT_E_STOP, badge, simulation_block
from hilcell.tui.widgets import Column

WORDS = {  # by status: the word, its tone, its shape
    "running": (marked("running"), "live", "fresh"),
    "proved": (marked("proved"), "passed", "done"),
    "failed": (marked("DIFFERS"), "fault", "lost"),
    "changed": (marked("edited"), "ask", "warned"),
    "open": (marked("open"), "label", "stale"),
}
MOST_SAID = 4
DIFFERS, HOLDS = marked("DIFFERS"), marked("holds")


@dataclass(frozen=True, slots=True)
class StepRow:
    """One step in the list."""

    name: str
    status: str
    shape: str

    @property
    def word(self) -> str:
        return tr(WORDS[self.status][0])

    @property
    def tone(self) -> str:
        return WORDS[self.status][1]


STEP_COLUMNS = (
    Column[StepRow]("", 1, lambda row: row.shape),
    Column[StepRow]("step", 11, lambda row: row.name),
    Column[StepRow]("status", 7, lambda row: row.word),
)
CHECK_COLUMNS = (
    Column[Check]("what", 15, lambda check: check.what),
    Column[Check]("found", 13, lambda check: check.found, grows=True),
    Column[Check]("expected", 13, lambda check: check.expected),
    Column[Check]("", 7, lambda check: tr(HOLDS if check.holds else DIFFERS)),
)


def check_tone(check: Check) -> str:
    return "" if check.holds else "fault"


def step_rows(progress: Progress | None, running: str, glyphs: Glyphs) -> list[StepRow]:
    """Return every step; ``running``: the one in work, "" for none."""
    statuses: dict[str, str] = {step.name: "open" for step in STEPS}
    if progress is not None:
        statuses = {**progress.statuses}
    if running:
        statuses[running] = "running"
    return [
        StepRow(name, status, getattr(glyphs, WORDS[status][2]))
        for name, status in statuses.items()
    ]


def worst_first(checks: Iterable[Check]) -> list[Check]:
    return sorted(checks, key=lambda check: check.holds)


def check_lines(check: Check) -> Lines:
    """Return one check in full, with the values of the cell file that it proves."""
    found: Text = harmless(check.found)
    if not check.holds:
        found = Content.assemble((f"{tr(DIFFERS)}: ", "bold $fault"), found)
    values = [f"{path} = {harmless(str(value))}" for path, value in check.values.items()]
    rows: list[tuple[str, Text]] = [
        (tr("what"), harmless(check.what)),
        (tr("found"), found),
        (tr("expected"), harmless(check.expected)),
    ]
    return labelled_rows([*rows, *[(tr("written"), each) for each in values]], 9)


def question_lines(question: Question, how: str) -> Lines:
    """Return a question in full; ``how``: how a person agrees to a motion."""
    lines: list[Lines | Text] = []
    for line in question.text.splitlines():
        words = line.lstrip()
        indent = len(line) - len(words)
        lines.append(
            Grid([("•", harmless(words))], Col(), Col(grows=True, wraps=True))
            if indent
            else Content.styled(harmless(words), "bold")
        )
    if question.motion and how:
        lines.append(Content.styled(tr("{how}; another answer moves nothing", how=how), "$ask"))
    elif question.default and not question.choices:
        lines.append(
            Content.styled(
                tr("Enter alone: {default}", default=harmless(question.default)), "$label"
            )
        )
    return Stack(*lines)


def subject_lines(number: str, title: str) -> Lines:
    return Stack(section(harmless(number)), *([(title, "$label")] if title else []))


def said_lines(chosen: str, said: Sequence[str]) -> Lines:
    """Return the text of the choice under the cursor, and the newest messages."""
    return Stack(
        *([harmless(chosen)] if chosen else []),
        *[(harmless(each), "$label") for each in said[-MOST_SAID:]],
    )


def banner(glyphs: Glyphs, *, asks: bool, at_work: bool, simulated: bool) -> Lines:
    """Return the first row while no run is live."""
    word, shape = (tr("IN WORK"), glyphs.moving) if at_work else (tr("AT REST"), glyphs.stale)
    if asks:
        word, shape = tr("QUESTION"), glyphs.states["suspended"]
    blocks = [badge(f"{shape} {tr('COMMISSION')}"), badge(word)]
    left = Content(" ").join([*blocks, *([simulation_block()] if simulated else [])])
    words = tr(NOT_E_STOP) if at_work and not asks else tr("nothing moves before you agree")
    rest = Fitting((Content.styled(words, "$label"), BLANK))
    return Grid([(left, rest)], Col(), Col(right=True, grows=True))


def outcome_lines(outcome: str, progress: Progress | None) -> Lines:
    """Return how the last go has ended, and which step is next."""
    parts: list[Lines | Text] = []
    if outcome:
        parts.append(Content.styled(harmless(outcome), "bold $ask"))
    if progress is not None:
        parts.append(Content.styled(harmless(progress.standing), "bold"))
        if progress.next_step:
            parts.append(
                Content.styled(
                    tr("Enter goes on with step {step}", step=progress.next_step), "bold"
                )
            )
    return Stack(*parts)
