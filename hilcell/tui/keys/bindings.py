"""The application's keys as Textual wants them: all act before widgets see them, in their order."""

from __future__ import annotations

from textual.binding import Binding, BindingType

from hilcell.tui.keys.table import ACTIONS, Action

FOCUS: tuple[BindingType, ...] = (
    Binding("tab", "focus_next", show=False, priority=True),
    Binding("shift+tab", "focus_previous", show=False, priority=True),
)


def binding_of(action: Action) -> Binding:
    """Return the keys of an action; its name is what a file of keys rebinds it by."""
    return Binding(
        ",".join(action.keys),
        f"do('{action.name}')",
        action.label,
        show=False,
        id=action.name,
        priority=True,
    )


BINDINGS: list[BindingType] = [*FOCUS, *map(binding_of, ACTIONS)]
