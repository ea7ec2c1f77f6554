"""The runs that this screen is attached to: the one that is shown, and its own live one behind it.

The live run that is left to look at others keeps its line: a stop reaches it as before, and its
engine still learns when this screen is lost. Other live runs are visited only: a screen that
watches them elsewhere goes on doing so.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hilcell.tui.engine.session import Session


class OpenRuns:
    """Holds the sessions; each is closed once it is neither shown nor the live one behind."""

    def __init__(self) -> None:
        self.shown: Session | None = None
        self.behind: Session | None = None

    @property
    def all(self) -> list[Session]:
        """Return both; the live one first, for a past run may lie on a disk that answers late."""
        return [each for each in (self.behind, self.shown) if each is not None]

    @property
    def live(self) -> list[Session]:
        """Return the sessions whose runs have an engine at work."""
        return [each for each in self.all if each.scene.live]

    def show(self, session: Session | None) -> None:
        """Show a run, or none; this screen's own live one goes on behind it."""
        left, visiting = self.shown, self.behind is not None
        self.shown = session
        if session is self.behind:
            self.behind = None
        if left is None:
            return
        again = session is not None and session.folder == left.folder
        if left.scene.live and not visiting and not again:
            self.behind = left
        else:
            left.close(leave=True)

    def drop_ended(self) -> Session | None:
        """Let go of the run behind, if it has ended; return it then."""
        ended = self.behind
        if ended is None or ended.scene.live:
            return None
        self.behind = None
        ended.close(leave=True)
        return ended

    def stop(self) -> bool:
        """Stop everything, from whatever thread; return whether an engine was there to hear."""
        sent = [each.stop() for each in self.all]  # each of them, not the first alone
        return any(sent)

    def leave(self) -> None:
        """Let go of every run; live ones go on."""
        for each in self.all:
            each.close(leave=True)
        self.shown = self.behind = None
