"""The palette: every action by its words, the allowed ones first seen without typing."""

from __future__ import annotations

from typing import ClassVar, cast

from textual.binding import Binding, BindingType
from textual.command import CommandPalette, DiscoveryHit, Hit, Hits, Provider
from textual.widgets import Input

from hilcell.tui.desk import Desk
from hilcell.tui.keys import ACTIONS, Action


class Palette(CommandPalette):
    """Textual's own, but its Enter acts at once: a second one in a burst finds it closed."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("enter", "enter", show=False, priority=True)]

    async def action_enter(self) -> None:
        """Choose what is highlighted."""
        await self.query_one(Input).action_submit()


class Actions(Provider):
    """What can be done now."""

    async def discover(self) -> Hits:
        """Yield every allowed action; the stop last, for it has a key that needs no palette."""
        for action in sorted(self._allowed(), key=lambda action: action.name == "stop"):
            yield DiscoveryHit(_words(action), lambda name=action.name: self._desk.do(name))

    async def search(self, query: str) -> Hits:
        """Yield the allowed actions that match."""
        matcher = self.matcher(query)
        for action in self._allowed():
            score = matcher.match(_words(action))
            if score > 0:
                yield Hit(score, _words(action), lambda name=action.name: self._desk.do(name))

    def _allowed(self) -> list[Action]:
        return [action for action in ACTIONS if self._desk.allowed(action.name)]

    @property
    def _desk(self) -> Desk:
        return cast("Desk", self.app)


def _words(action: Action) -> str:
    return f"{action.label}: {action.help}"
