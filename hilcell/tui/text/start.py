"""The page for a new run as text: the plan, its checks, what to do before, and the start."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

from textual.content import Content

from hilcell.cell.file import Cell
from hilcell.clean import harmless
from hilcell.journal.key_words import in_words
from hilcell.journal.log import Log
from hilcell.journal.point_words import procedure_words, step_words
from hilcell.tui.terminal.capabilities import Glyphs
from hilcell.tui.text.frame import ends, fitted, wrapped
from hilcell.tui.text.lines import section
from hilcell.tui.text.run import badge, duration, simulation_block

NUMBERS = 9  # columns of `points`, and of `takes`
NOTHING_MOVES = "nothing moves before you start"
REFUSED = " refused before anything moves"  # after the procedure, in a plan's refusal
FEW = 4  # nests that are named one by one


@dataclass(frozen=True, slots=True)
class Checked:
    """The plan of the fields as they stand, or why it is refused, or nothing yet."""

    plan: dict[str, Any] | None = None
    refused: str = ""
    cell: Cell | None = None
    at: datetime | None = None

    @property
    def simulated(self) -> bool:
        """Whether only a simulated cell would move."""
        if self.plan is None:
            return self.cell is not None and self.cell.simulation is not None
        return bool(self.plan.get("simulated"))

    @property
    def has_rail(self) -> bool:
        """Whether the cell has a rail."""
        return self.plan is None or bool(self.plan.get("rail", True))


def banner(checked: Checked, glyphs: Glyphs, width: int) -> Content:
    """Return the first line: that nothing is opened, and whether the cell is simulated."""
    blocks = [badge(f"{glyphs.stale} NEW RUN"), badge("NOTHING OPENED")]
    left = Content(" ").join([*blocks, *([simulation_block()] if checked.simulated else [])])
    right = Content.styled(NOTHING_MOVES, "$label")
    return ends(left, right, width) if width > left.cell_length + right.cell_length else left


def plan_lines(checked: Checked, glyphs: Glyphs, width: int, rows: int) -> list[Content]:
    """Return the steps with their points and durations, numbered as in the run.

    Where room is short, steps that do nothing are left out first.
    """
    plan, room = checked.plan, width - 2 * NUMBERS
    if checked.refused:
        reasons = _refusals(checked, glyphs, width, rows - 1)
        return [section("plan", width, "refused"), *reasons][:rows]
    if plan is None:
        return [section("plan", width), Content.styled("  is being checked ...", "$label")]
    names = f"{' points':─>{NUMBERS}}{'takes':>{NUMBERS}}"
    lines = [section("plan", room).append(Content.styled(names, "$label"))]
    steps, most = [*enumerate(plan["steps"], start=1)], rows - len(lines) - 1
    if len(steps) > most:
        steps = [(n, step) for n, step in steps if step["points"] or step["duration_s"]]
    shown = steps if len(steps) <= most else steps[: max(most - 1, 0)]
    lines += [_step_line(n, step, checked, room) for n, step in shown]
    if len(shown) < len(steps):
        lines.append(Content.styled(f"   and {len(steps) - len(shown)} more steps", "$label"))
    count = f"   all {len(plan['steps'])} steps"
    total = _row(count, str(plan["points"]), duration(plan["duration_s"]), room)
    return [*lines, Content.styled(total, "bold")]


def _step_line(number: int, step: dict[str, Any], checked: Checked, room: int) -> Content:
    name = step_words(step["name"], has_rail=checked.has_rail)
    takes = duration(step["duration_s"]) if step["duration_s"] else "-"
    return Content(_row(f"{number:>2} {name}", str(step["points"] or "-"), takes, room))


def _row(name: str, points: str, takes: str, room: int) -> str:
    return f"{harmless(name)[:room]:<{room}}{points:>{NUMBERS}}{takes:>{NUMBERS}}"


def check_lines(checked: Checked, glyphs: Glyphs, width: int, rows: int) -> list[Content]:
    """Return what has been checked, or every refusal with its reason, as far as there is room."""
    if checked.refused:
        lines = _refusals(checked, glyphs, width, rows - 1)
        return [section("checks", width, "refused"), *lines][:rows]
    if checked.plan is None:
        return [section("checks", width), Content.styled("  being done ...", "$label")][:rows]
    said = ["cell file and options are sound"]
    said += ["poses in reach, in limits, in sight"] if checked.plan["points"] else []
    said += ["the slide's way is clear"] if checked.has_rail else []
    done = [Content.assemble((f"{glyphs.fresh} ", "$passed"), words) for words in said]
    at = "" if checked.at is None else f" at {checked.at:%H:%M}"
    return [section("checks", width, f"{len(said)} of {len(said)}{at}"), *done][:rows]


def _refusals(checked: Checked, glyphs: Glyphs, width: int, rows: int) -> list[Content]:
    """Return each line of a refusal whole, where ``rows`` are enough; else each one's beginning."""
    texts = [harmless(text) for text in refused_words(checked) if text]
    whole = [wrapped(text, width - 2) for text in texts]
    if sum(map(len, whole)) > rows:
        most = max(rows // max(len(texts), 1), 1)
        whole = [wrapped(text, width - 2, most=most) for text in texts]
    lines = []
    for first, *rest in whole:
        lines.append(Content.styled(f"{glyphs.warned} ", "bold $ask").append(first))
        lines += [line.pad_left(2) for line in rest]
    return lines


def refused_words(checked: Checked) -> list[str]:
    """Return the lines of a refusal; those of a plan name procedure, steps and points in words."""
    first, *rest = map(str.strip, checked.refused.splitlines() or [""])
    name, refused, why = first.partition(REFUSED)
    if not refused:
        return [first, *rest]
    begin = f"{procedure_words(name)}{refused}{why}"
    return [begin, *(_in_words(line, checked) for line in rest)]


def _in_words(line: str, checked: Checked) -> str:
    step, colon, reason = line.partition(": ")
    words = step_words(step, has_rail=checked.has_rail) if colon else step
    return f"{words}{colon}{in_words(reason, Log())}"


def before_lines(checked: Checked, width: int, *, attended: bool) -> list[Content]:
    """Return what to see to before the start."""
    words = ["Nobody in the cell, guard closed, E-stop in reach."]
    if checked.cell is not None:
        words.append(_reflectors(checked.cell))
    words.append("Tracker on for two hours at least; doors closed.")
    if not attended:
        words.append("Unattended: nobody answers; a question waits, then ends the run.")
    lines = [section("before you start", width)]
    return lines + [fitted(Content.assemble(("• ", "$label"), each), width) for each in words]


def _reflectors(cell: Cell) -> str:
    layout = cell.layout
    if layout.by_hand:
        return "One reflector, clean: you are asked when to carry it, and where."
    groups = (layout.floor, layout.bar, layout.slide)
    shown = ", ".join(_nests([nest.name for nest in group]) for group in groups if group)
    return f"Reflectors in {shown}, clean; one on the tool."


def _nests(names: list[str]) -> str:
    return " ".join(names) if len(names) <= FEW else f"{names[0]} to {names[-1]}"


def start_line(checked: Checked, width: int) -> Content:
    """Return the key that starts, grey while it would not, and what will move."""
    if checked.plan is None:
        why = "does nothing: the plan is refused" if checked.refused else "asks once it is checked"
        grey = Content.styled(" Enter ", "$stale on $badge")
        return fitted(grey.append(Content.styled(f" {why}", "$stale")), width)
    words = "robot and rail will move" if checked.has_rail else "robot will move"
    key = Content.styled(" Enter ", "bold $on-ask on $ask-fill")
    line = key.append(Content.styled(f" start: {words}", "bold"))
    if not checked.simulated:
        return fitted(line, width)
    only = Content.styled(" in simulation only: ", "$sim"), simulation_block()
    whole = Content("").join([line, *only])
    if whole.cell_length <= width:
        return fitted(whole, width)
    short = Content("").join([key.append(Content.styled(" start: ", "bold")), simulation_block()])
    return fitted(short, width)


def end_line(checked: Checked, speed: str) -> Content:
    """Return when the run will end; of a simulation that is not paced, how long it takes there."""
    if checked.plan is None or checked.at is None:
        return Content("")
    duration_s = checked.plan["duration_s"]
    if checked.simulated and speed != "1":
        return Content.styled(f"takes {duration(duration_s)} of the cell's time", "$label")
    end = checked.at + timedelta(seconds=duration_s)
    return Content.styled(f"ends about {end:%H:%M}, if nothing has to wait", "$label")
