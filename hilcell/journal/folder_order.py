"""The order of the runs of a folder, which no clock decides.

A run that begins, or goes on, journals the run before it and takes the next number of the folder.
Runs of one cell exclude one another, so their numbers say which one ended later, also where the
clock of the PC was wrong meanwhile. Runs of another folder are merged with them by the clock.
"""

from __future__ import annotations

import heapq
import secrets
from collections import defaultdict
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime, timedelta
from typing import Protocol, TypeVar

from hilcell.journal.journal import Record
from hilcell.model.events import SessionOrdered
from hilcell.model.plan import FolderOrder, PlanRecord
from hilcell.model.records import StateChanged

CLOCK_STEP = timedelta(minutes=1)  # that a clock is set back by the network says nothing


class Row(Protocol):
    """A run as `hilcell.journal.index.RunRow` has it."""

    @property
    def name(self) -> str:
        """Return the run's name."""

    @property
    def begun(self) -> str:
        """Return when it began (UTC, ISO 8601)."""

    @property
    def session(self) -> str:
        """Return when its last session began; "" where that is not known."""

    @property
    def order(self) -> FolderOrder:
        """Return which session that is."""

    @property
    def readable(self) -> bool:
        """Whether its journal could be read."""


R = TypeVar("R", bound=Row)


class SessionReader:
    """Gathers from a journal's records which session the last one is, and when it began (UTC, ms).

    A session takes its number before it begins: one that is refused has none.
    """

    def __init__(self) -> None:
        self.order, self.began = FolderOrder(), ""
        self._taken = self.order

    def take(self, record: Record) -> None:
        """Add one record; raises `msgspec.ValidationError`."""
        match record.fact if record.kind in ("plan", "event", "state") else None:
            case PlanRecord(order=order):
                self.order = self._taken = order
            case SessionOrdered(folder=folder, number=number, after=after):
                self._taken = FolderOrder(folder, number, after)
            case StateChanged(to="checking"):
                self.order, self.began = self._taken, f"{record.t[:23]}Z"


def in_order(rows: Iterable[R]) -> list[R]:
    """Return runs in the order in which their last sessions began."""
    folders: defaultdict[str, list[R]] = defaultdict(list)
    for row in rows:
        folders[row.order.folder].append(row)
    for of_folder in folders.values():
        of_folder.sort(key=lambda row: (row.order.number, _by_clock(row)))
    return list(heapq.merge(*folders.values(), key=_by_clock))


def next_order(rows: Iterable[Row]) -> FolderOrder:
    """Return the order of a session that begins now; an unreadable run may have a number."""
    rows = list(rows)
    numbered = [row for row in in_order(rows) if row.order.folder]
    if not numbered:
        return FolderOrder(secrets.token_hex(8), 1)
    last = numbered[-1]
    highest = max(row.order.number for row in numbered if row.order.folder == last.order.folder)
    unread = sum(not row.readable for row in rows)
    return FolderOrder(last.order.folder, highest + unread + 1, last.name)


def clock_notes(rows: Iterable[Row], now: datetime | None = None) -> Iterator[str]:
    """Yield where the PC's clock ran back between two runs of a folder, and before ``now``."""
    latest: dict[str, Row] = {}
    for row in in_order(row for row in rows if row.order.folder):
        before = latest.setdefault(row.order.folder, row)
        began, earlier = _began(row), _began(before)
        if earlier - began > CLOCK_STEP:
            yield _ran_back(before, earlier, f"run {row.name} began after it, at", began)
        elif began > earlier:
            latest[row.order.folder] = row
    for row in latest.values():
        if now is not None and _began(row) - now > CLOCK_STEP:
            yield _ran_back(row, _began(row), "now it is", now)


def _ran_back(before: Row, earlier: datetime, then: str, later: datetime) -> str:
    hours = (earlier - later) / timedelta(hours=1)
    return (
        f"the clock ran back by {hours:.2f} h: run {before.name} began {_utc(earlier)}, {then} "
        f"{_utc(later)}; the order of the runs holds, their times do not: check the PC's clock"
    )


def _utc(moment: datetime) -> str:
    return f"{moment:%Y-%m-%dT%H:%M:%SZ}"


def _by_clock(row: Row) -> tuple[str, str]:
    return row.session or row.begun, row.name


def _began(row: Row) -> datetime:
    return datetime.fromisoformat(row.session or row.begun).astimezone(UTC)
