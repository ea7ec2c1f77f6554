"""The page for a new run as text: the plan, its checks, what to do before, and the start."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

from textual.content import Content

from hilcell.cell.file import Cell
from hilcell.clean import harmless
from hilcell.journal.point_words import step_words
from hilcell.tui.terminal.capabilities import Glyphs
from hilcell.tui.text.frame import ends, fitted, wrapped
from hilcell.tui.text.lines import section
from hilcell.tui.text.run import badge, duration, simulation_block

NUMBERS = 9  # columns of `points`, and of `takes`
NOTHING_MOVES = "nothing moves before you start"
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
    """Return the steps with their points and durations; steps that do nothing are left out."""
    plan, room = checked.plan, width - 2 * NUMBERS
    if checked.refused:
        reasons = _refusals(checked, glyphs, width, rows - 1)
        return [section("plan", width, "refused"), *reasons][:rows]
    if plan is None:
        return [section("plan", width), Content.styled("  is being checked ...", "$label")]
    names = f"{' points':─>{NUMBERS}}{'takes':>{NUMBERS}}"
    lines = [section("plan", room).append(Content.styled(names, "$label"))]
    steps = [step for step in plan["steps"] if step["points"] or step["duration_s"]]
    most = rows - len(lines) - 1
    shown = steps if len(steps) <= most else steps[: max(most - 1, 0)]
    lines += [
        Content(
            _row(
                f"{n:>2} {step_words(step['name'])}",
                _points(step),
                duration(step["duration_s"]),
                room,
            )
        )
        for n, step in enumerate(shown, start=1)
    ]
    if len(shown) < len(steps):
        lines.append(Content.styled(f"   and {len(steps) - len(shown)} more steps", "$label"))
    total = _row("   all", str(plan["points"]), duration(plan["duration_s"]), room)
    return [*lines, Content.styled(total, "bold")]


def _row(name: str, points: str, takes: str, room: int) -> str:
    return f"{harmless(name)[:room]:<{room}}{points:>{NUMBERS}}{takes:>{NUMBERS}}"


def _points(step: dict[str, Any]) -> str:
    return str(step["points"] or "-")


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
    texts = [harmless(text) for text in map(str.strip, checked.refused.splitlines()) if text]
    whole = [wrapped(text, width - 2) for text in texts]
    if sum(map(len, whole)) > rows:
        most = max(rows // max(len(texts), 1), 1)
        whole = [wrapped(text, width - 2, most=most) for text in texts]
    lines = []
    for first, *rest in whole:
        lines.append(Content.styled(f"{glyphs.warned} ", "bold $ask").append(first))
        lines += [line.pad_left(2) for line in rest]
    return lines


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
    if checked.simulated:
        line = line.append(Content.styled(" in simulation only: ", "$sim")).append(
            simulation_block()
        )
    return fitted(line, width)


def end_line(checked: Checked, speed: str) -> Content:
    """Return when the run will end; of a simulation that is not paced, how long it takes there."""
    if checked.plan is None or checked.at is None:
        return Content("")
    duration_s = checked.plan["duration_s"]
    if checked.simulated and speed != "1":
        return Content.styled(f"takes {duration(duration_s)} of the cell's time", "$label")
    end = checked.at + timedelta(seconds=duration_s)
    return Content.styled(f"ends about {end:%H:%M}, if nothing has to wait", "$label")
