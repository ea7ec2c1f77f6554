"""The runs that this screen is attached to: the one shown, and a live one in the background.

The background run keeps its connection: a stop reaches it as before, and its engine still learns
when this screen is lost. Other live runs are only visited: other screens go on watching them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hilcell.tui.engine.session import Session


class OpenRuns:
    """Holds the sessions; each is closed once it is neither shown nor in the background."""

    def __init__(self) -> None:
        self.shown: Session | None = None
        self.background: Session | None = None

    @property
    def all(self) -> list[Session]:
        """Return both; the live one first, for a past run may lie on a disk that answers late."""
        return [each for each in (self.background, self.shown) if each is not None]

    @property
    def live(self) -> list[Session]:
        return [each for each in self.all if each.view.live]

    def show(self, session: Session | None) -> None:
        """Show a run, or none; a live one goes on in the background."""
        left, visiting = self.shown, self.background is not None
        self.shown = session
        if session is self.background:
            self.background = None
        if left is None:
            return
        again = session is not None and session.folder == left.folder
        if left.view.live and not visiting and not again:
            self.background = left
        else:
            left.close(leave=True)

    def close_ended(self) -> Session | None:
        """Close the background run if it has ended; return it then."""
        ended = self.background
        if ended is None or ended.view.live:
            return None
        self.background = None
        ended.close(leave=True)
        return ended

    def stop(self) -> bool:
        """Stop everything, from any thread; return whether an engine received it."""
        sent = [each.stop() for each in self.all]  # each of them, not the first alone
        return any(sent)

    @property
    def stop_heard(self) -> bool:
        """Whether the engine of each live run received a stop, which may have ended it since."""
        return bool(self.live) and all(each.stop_heard for each in self.live)

    def leave(self) -> None:
        """Detach from every run; live ones go on."""
        for each in self.all:
            each.close(leave=True)
        self.shown = self.background = None
