"""The runs that this screen is attached to: the one that is shown, and live ones behind it.

A live run that is left to look at another one keeps its line: a stop reaches it as before, and
its engine still learns when this screen is lost.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hilcell.tui.session import Session


class Attached:
    """Holds the sessions; each is closed once it is neither shown nor live."""

    def __init__(self) -> None:
        self.shown: Session | None = None
        self.behind: list[Session] = []

    def __contains__(self, session: object) -> bool:
        return session is self.shown or session in self.behind

    @property
    def live(self) -> list[Session]:
        """Return the sessions whose runs have an engine at work."""
        shown = [self.shown] if self.shown is not None and self.shown.scene.live else []
        return [*shown, *self.behind]

    def of(self, folder: Path) -> Session | None:
        """Return the session of a run behind the one shown."""
        return next((each for each in self.behind if each.folder == folder), None)

    def show(self, session: Session | None) -> None:
        """Show a run, or none; one that is live and left goes on behind it."""
        left, self.shown = self.shown, session
        self.behind = [each for each in self.behind if each is not session]
        if left is None:
            return
        if left.scene.live and (session is None or session.folder != left.folder):
            self.behind.append(left)
        else:
            left.close(leave=True)

    def drop_ended(self) -> list[Session]:
        """Let go of runs that have ended behind the one shown; return them."""
        ended = [each for each in self.behind if not each.scene.live]
        self.behind = [each for each in self.behind if each.scene.live]
        for each in ended:
            each.close(leave=True)
        return ended

    def stop(self) -> bool:
        """Stop everything, from whatever thread; return whether an engine was there to hear."""
        sent = [each.stop() for each in self._all()]  # each of them, not the first alone
        return any(sent)

    def leave(self) -> None:
        """Let go of every run; live ones go on."""
        for each in self._all():
            each.close(leave=True)
        self.shown, self.behind = None, []

    def _all(self) -> list[Session]:
        """Return live ones first: a past run may lie on a disk that answers late."""
        return [*self.behind, *([self.shown] if self.shown is not None else [])]
