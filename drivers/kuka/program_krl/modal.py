"""In which base and tool each motion runs, on every way that the program may take to it.

Base and tool stay as they were last set, past the ends of branches, loops and subprograms: a home
move's frame data at a loop's end hold for the loop's begin, too. ``WITH`` holds for its own motion
alone, and leaves those beside it where they were. ``BAS(#CP_PARAMS,...)`` and its like set base and
tool by the frame data that ``FDAT_ACT`` was last set to, whatever was set since.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from drivers.kuka.program_krl.flow import Flow
from drivers.kuka.program_krl.frames import APPLY, FORM, RESET, FrameRule, Stated
from drivers.kuka.program_krl.strokes import STROKES
from drivers.kuka.program_krl.tokens import Statement


class Modal(NamedTuple):
    """Base and tool in force, None as they were before the program, and FDAT_ACT, if it was set."""

    base: Stated | None = None
    tool: Stated | None = None
    form: str = ""


def check_modal(
    file: str, blocks: Mapping[str, Sequence[Statement]], frames: FrameRule
) -> list[str]:
    """Return the motions that may run in another base or tool than those of the program."""
    found: dict[int, str] = {}
    ask = "set FDAT_ACT and BAS(#FRAMES)" if frames.by_form else "set base and tool again"

    def judge(statement: Statement, what: str, used: Stated | None, stated: Stated | None) -> None:
        if used is stated or (used is not None and stated is not None and used.same(stated)):
            return
        expected = f"{stated.text} (line {stated.line})" if stated else "none set by the program"
        runs = (
            f"{used.text} (line {used.line})"
            if used
            else "that of before the program (WITH holds for its own motion alone)"
        )
        found.setdefault(
            statement.line,
            f"{file} line {statement.line}: {statement.head} may run in another {what}: expected "
            f"{expected}, got {runs}; {ask} before this motion",
        )

    def step(statement: Statement, before: Modal) -> list[Modal]:
        after = _set(frames, statement.line, before)
        if statement.line in frames.motions:
            form = frames.motions[statement.line]
            used = _applied(frames, statement.line, after, form) if form else after
            judge(statement, "tool", used.tool, frames.tool)
            if statement.head not in STROKES:
                judge(statement, "base", used.base, frames.base)
        return [after]

    Flow(blocks, step).follow(Modal())
    return [found[line] for line in sorted(found)]


def _set(frames: FrameRule, line: int, state: Modal) -> Modal:
    """Return what the statement of a line leaves in force."""
    for what, value in frames.settings.get(line, ()):
        if what == RESET:
            state = Modal(form=state.form)
        elif what == FORM:
            state = _applied(frames, line, state._replace(form=str(value)), str(value))
        elif what == APPLY:
            state = _applied(frames, line, state, state.form)
        elif isinstance(value, Stated) and what == "base":
            state = state._replace(base=value)
        elif isinstance(value, Stated):
            state = state._replace(tool=value)
    return state


def _applied(frames: FrameRule, line: int, state: Modal, form: str) -> Modal:
    """Return base and tool by frame data; without any named, those of before the program."""
    if not form and state.base is None and state.tool is None:
        return state
    base, tool = frames.of_form(form, line)
    return state._replace(base=base, tool=tool)
