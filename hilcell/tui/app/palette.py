"""The palette: every action by its words, the allowed ones first seen without typing."""

from __future__ import annotations

from typing import ClassVar, cast

from textual.binding import Binding, BindingType
from textual.command import CommandPalette, DiscoveryHit, Hit, Hits, Provider
from textual.widgets import Input

from hilcell.tui.keys.table import ACTIONS, Action
from hilcell.tui.screens.application import Application

HINT = "what to do?   ^p or Backspace: back   Esc: STOP"


class Palette(CommandPalette):
    """Textual's own, but its Enter acts at once: a second one in a burst finds it closed."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("enter", "enter", show=False, priority=True),
        Binding("backspace", "erase", show=False, priority=True),
    ]

    def __init__(self) -> None:
        super().__init__(placeholder=HINT, id="--command-palette")

    async def action_enter(self) -> None:
        """Choose what is highlighted."""
        await self.query_one(Input).action_submit()

    def action_erase(self) -> None:
        """Take a letter back; with none left, go back."""
        box = self.query_one(Input)
        if box.value:
            box.action_delete_left()
        else:
            self.dismiss()


class Actions(Provider):
    """What can be done now."""

    async def discover(self) -> Hits:
        """Yield every allowed action; the stop last, for it has a key that needs no palette."""
        for action in sorted(self._allowed(), key=lambda action: action.name == "stop"):
            yield DiscoveryHit(self._words(action), lambda name=action.name: self._desk.do(name))

    async def search(self, query: str) -> Hits:
        """Yield the allowed actions that match."""
        matcher = self.matcher(query)
        for action in self._allowed():
            score = matcher.match(self._words(action))
            if score > 0:
                yield Hit(score, self._words(action), lambda name=action.name: self._desk.do(name))

    def _allowed(self) -> list[Action]:
        return [action for action in ACTIONS if self._desk.allowed(action.name)]

    @property
    def _desk(self) -> Application:
        return cast("Application", self.app)

    def _words(self, action: Action) -> str:
        return f"{self._desk.label(action.name)}: {action.help}"
