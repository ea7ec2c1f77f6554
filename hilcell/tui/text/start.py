"""The page for a new run as text: the plan, its checks, what to do before, and the start."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta

from textual.content import Content

from hilcell.cell.file import Cell
from hilcell.clean import harmless
from hilcell.journal.log import Log
from hilcell.journal.words import in_words, procedure_words, step_words
from hilcell.tui.engine.process import DryRun
from hilcell.tui.layout import BLANK, Col, Drawing, Fitting, Grid, Lines, Stack, Text, ends, section
from hilcell.tui.terminal.capabilities import Glyphs
from hilcell.tui.text.run import badge, duration, simulation_block

REFUSED = " refused before anything moves"  # after the procedure, in a plan's refusal
FEW = 4  # nests that are named one by one


@dataclass(frozen=True, slots=True)
class Checked:
    """The plan of the fields as they stand, or why it is refused, or nothing yet."""

    plan: DryRun | None = None
    refused: str = ""
    cell: Cell | None = None
    at: datetime | None = None

    @property
    def simulated(self) -> bool:
        """Whether only a simulated cell would move."""
        if self.plan is None:
            return self.cell is not None and self.cell.simulation is not None
        return self.plan.simulated

    @property
    def has_rail(self) -> bool:
        """Whether the cell has a rail."""
        return self.plan is None or self.plan.rail


def banner(checked: Checked, glyphs: Glyphs) -> Lines:
    """Return the first line: that nothing is opened, and whether the cell is simulated."""
    blocks = [badge(f"{glyphs.stale} NEW RUN"), badge("NOTHING OPENED")]
    left = Content(" ").join([*blocks, *([simulation_block()] if checked.simulated else [])])
    nothing = Fitting((Content.styled("nothing moves before you start", "$label"),))
    return Grid([(left, nothing)], Col(), Col(right=True, grows=True))


def plan_lines(checked: Checked, glyphs: Glyphs) -> Lines:
    """Return the steps with their points and durations, numbered as in the run.

    Where room is short, steps that do nothing are left out first.
    """
    plan = checked.plan
    if checked.refused:
        return Stack(section("plan", "refused"), refusals(checked, glyphs))
    if plan is None:
        return Stack(section("plan"), ("  is being checked ...", "$label"))
    whole = [*enumerate(plan.steps, start=1)]

    def draw(width: int, height: int) -> list[Content]:
        steps, most = whole, (height or len(whole) + 2) - 2
        if len(steps) > most:
            steps = [(n, step) for n, step in steps if step.points or step.duration_s]
        shown = steps if len(steps) <= most else steps[: max(most - 1, 0)]
        rows: list[list[Text]] = []
        for n, step in shown:
            name = harmless(step_words(step.name, has_rail=checked.has_rail))
            takes = duration(step.duration_s) if step.duration_s else "-"
            rows.append([f"{n:>2} {name}", str(step.points or "-"), takes, ""])
        if len(shown) < len(steps):
            rows.append([f"   {len(steps) - len(shown)} more steps", "", "", ""])
        total = str(plan.points), duration(plan.duration_s)
        rows.append(
            [(f"   all {len(whole)} steps", "bold"), *((each, "bold") for each in total), ""]
        )
        columns = Col(grows=True), Col(8, right=True), Col(8, right=True), Col(1)
        heading = section("plan", "points    takes").lines(width)
        return [*heading, *Grid(rows, *columns).lines(width)]

    return Drawing(repr(plan), draw)


def check_lines(checked: Checked, glyphs: Glyphs) -> Lines:
    """Return what has been checked, or every refusal with its reason."""
    if checked.refused:
        return Stack(section("checks", "refused"), refusals(checked, glyphs))
    if checked.plan is None:
        return Stack(section("checks"), ("  being done ...", "$label"))
    said = ["cell file and options are sound"]
    said += ["poses in reach, in limits, in sight"] if checked.plan.points else []
    said += ["the slide's way is clear"] if checked.has_rail else []
    done = [Content.assemble((f"{glyphs.fresh} ", "$passed"), words) for words in said]
    at = "" if checked.at is None else f" at {checked.at:%H:%M}"
    return Stack(section("checks", f"{len(said)} of {len(said)}{at}"), *done)


def refusals(checked: Checked, glyphs: Glyphs) -> Lines:
    """Return each line of a refusal whole, where there are rows enough; else its beginning."""
    rows = [
        ((glyphs.warned, "bold $ask"), harmless(text)) for text in refused_words(checked) if text
    ]
    whole, cut = (Grid(rows, Col(), Col(grows=True, wraps=wraps)) for wraps in (True, False))

    def draw(width: int, height: int) -> list[Content]:
        lines = whole.lines(width)
        return lines if not height or len(lines) < height else cut.lines(width)

    return Drawing(whole.state, draw)


def refused_words(checked: Checked) -> list[str]:
    """Return the lines of a refusal; those of a plan name procedure, steps and points in words."""
    first, *rest = map(str.strip, checked.refused.splitlines() or [""])
    name, refused, why = first.partition(REFUSED)
    if not refused:
        return [first, *rest]
    lines = [f"{procedure_words(name)}{refused}{why}"]
    for line in rest:
        step, colon, reason = line.partition(": ")
        words = step_words(step, has_rail=checked.has_rail) if colon else step
        lines.append(f"{words}{colon}{in_words(reason, Log())}")
    return lines


def before_lines(checked: Checked, *, attended: bool) -> Lines:
    """Return what to see to before the start."""
    words = ["Nobody in the cell, guard closed, E-stop in reach."]
    if checked.cell is not None and checked.cell.layout.by_hand:
        words.append("One reflector, clean: you are asked when to carry it, and where.")
    elif checked.cell is not None:
        layout = checked.cell.layout
        groups = ([nest.name for nest in each] for each in (layout.floor, layout.bar, layout.slide))
        few = (
            " ".join(each) if len(each) <= FEW else f"{each[0]} to {each[-1]}"
            for each in groups
            if each
        )
        words.append(f"Reflectors in {', '.join(few)}, clean; one on the tool.")
    words.append("Tracker on for two hours at least; doors closed.")
    if not attended:
        words.append("Unattended: nobody answers; a question waits, then ends the run.")
    rows = ((("•", "$label"), each) for each in words)
    return Stack(section("before you start"), Grid(rows, Col(), Col(grows=True)))


def start_line(checked: Checked) -> Lines:
    """Return the key that starts, grey while it would not, and what will move."""
    if checked.plan is None:
        why = "does nothing: the plan is refused" if checked.refused else "asks once it is checked"
        grey = Content.assemble((" Enter ", "$stale on $badge"), (f" {why}", "$stale"))
        return ends(grey, "")
    words = "robot and rail will move" if checked.has_rail else "robot will move"
    key = Content.styled(" Enter ", "bold $on-ask on $ask-fill")
    line = key.append(Content.styled(f" start: {words}", "bold"))
    if not checked.simulated:
        return ends(line, "")
    only = Content.styled(" in simulation only: ", "$sim")
    whole = Content("").join([line, only, simulation_block()])
    short = Content("").join([key, Content.styled(" start: ", "bold"), simulation_block()])
    return Grid([[Fitting((whole, short))]], Col(grows=True))


def end_line(checked: Checked, speed: str) -> Content:
    """Return when the run will end; of a simulation that is not paced, how long it takes there."""
    if checked.plan is None or checked.at is None:
        return BLANK
    duration_s = checked.plan.duration_s
    if checked.simulated and speed != "1":
        return Content.styled(f"takes {duration(duration_s)} of the cell's time", "$label")
    end = checked.at + timedelta(seconds=duration_s)
    return Content.styled(f"ends about {end:%H:%M}, if nothing has to wait", "$label")
