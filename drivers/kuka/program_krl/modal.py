"""In which base and tool each motion runs, on every way that the program may take to it.

Base and tool stay as they were last set, past the ends of branches, loops and subprograms: a home
move's frame data at a loop's end hold for the loop's begin, too. ``WITH`` holds for its own motion
alone, and leaves those beside it where they were. ``BAS(#CP_PARAMS,...)`` and its like set base and
tool by the frame data that ``FDAT_ACT`` was last set to, whatever was set since.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import NamedTuple

from drivers.kuka.program_krl.flow import Flow
from drivers.kuka.program_krl.frames import APPLY, FORM, RESET, FrameRule, Stated
from drivers.kuka.program_krl.strokes import STROKES
from drivers.kuka.program_krl.tokens import Statement


class Modal(NamedTuple):
    """Base and tool in force, None as they were before the program, and those of FDAT_ACT."""

    base: Stated | None = None
    tool: Stated | None = None
    form: tuple[Stated, Stated] | None = None

    @property
    def frames(self) -> Hashable:
        """Return its frames without where they are set."""
        found = self.base, self.tool, *(self.form or (None, None))
        return tuple(None if each is None else each.frame for each in found)


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
        line, after = statement.line, _set(frames, statement.line, before)
        if line in frames.motions:
            base, tool = frames.motions[line]
            judge(statement, "tool", frames.of_form(tool, line)[1] if tool else after.tool,
                  frames.tool)  # fmt: skip
            if statement.head not in STROKES:
                judge(statement, "base", frames.of_form(base, line)[0] if base else after.base,
                      frames.base)  # fmt: skip
        return [after]

    Flow(blocks, step, lambda state: state.frames).follow(Modal())
    return [found[line] for line in sorted(found)]


def _set(frames: FrameRule, line: int, state: Modal) -> Modal:
    """Return what the statement of a line leaves in force."""
    for what, value in frames.settings.get(line, ()):
        if what == RESET:
            state = Modal(form=state.form)
        elif what == FORM:
            state = _applied(state._replace(form=frames.of_form(str(value), line)), line)
        elif what == APPLY and (state.form or state.base or state.tool):
            state = _applied(state._replace(form=state.form or frames.of_form("", line)), line)
        elif isinstance(value, Stated) and what == "base":
            state = state._replace(base=value)
        elif isinstance(value, Stated):
            state = state._replace(tool=value)
    return state


def _applied(state: Modal, line: int) -> Modal:
    """Return base and tool as FDAT_ACT has them, by the statement that changed them."""
    if state.form is None:
        return state
    base, tool = (
        before if before is not None and before.same(each) else each._replace(line=line)
        for before, each in zip((state.base, state.tool), state.form, strict=True)
    )
    return state._replace(base=base, tool=tool)
