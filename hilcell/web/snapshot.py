"""A run as the page shows it: one JSON object that holds all, so that a viewer may miss any."""

from __future__ import annotations

from datetime import datetime
from itertools import islice
from pathlib import Path
from typing import ClassVar

from hilcell.journal.journal import StorageError, read_journal
from hilcell.journal.labels import procedure_label, step_label, verdict_label, with_labels
from hilcell.journal.runs import JOURNAL, live_engine
from hilcell.model.point import CONTROL
from hilcell.model.verdicts import Verdict
from hilcell.run.last_word import last_word
from hilcell.run.notify import cleaned
from hilcell.tui.run_view import EngineState, RunView
from hilcell.tui.session import RunUpdate, Session
from hilcell.tui.terminal import UNICODE
from hilcell.tui.text.points import PointRow, expanded_uncertainty_mm, point_deviations, state_of
from hilcell.tui.text.run import RunText, Shown


class FollowedRun:
    """A run, followed by its journal alone; its engine is never asked more than whether it lives.

    The session's own feed, which attends the run, is not started.
    """

    MOST_POINTS: ClassVar = 12

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._session = Session(folder, lambda _: None, period_s=1.0)
        self._records_read = 0
        self._rows: list[dict[str, object]] = []

    def snapshot(self, now: datetime) -> dict[str, object]:
        """Return the run as it is now; ages in s, null where they are not known."""
        alive = live_engine(self._folder) is not None  # before its last records are read
        engine = EngineState.ANSWERING if alive else EngineState.NONE
        try:
            records = read_journal(self._folder / JOURNAL, after=self._records_read)
        except StorageError as error:
            update = RunUpdate([], engine, trouble="" if alive else str(error))
        else:
            self._records_read += len(records)
            update = RunUpdate(records, engine)
        self._session.take(update, now)
        view = self._session.view
        if update.records and view.log.plan is not None:
            self._rows = self._newest_rows(view)
        return {name: cleaned(value) for name, value in self._facts(view).items()}

    def _facts(self, view: RunView) -> dict[str, object]:
        word, tone = RunText(view).state_label()
        facts: dict[str, object] = {
            "run": view.run,
            "state": word,
            "tone": tone,
            "shape": UNICODE.states[view.state],
            "live": view.live,
            "simulated": view.simulated,
            "trouble": view.trouble,
        }
        plan, log = view.log.plan, view.log
        if plan is None:
            return facts
        over = not view.live and (view.ended or view.state == "gone")
        change = log.life[-1].change if log.life else None
        waits = view.live and change is not None and view.state in ("paused", "suspended")
        prompt = (change.prompt or {"text": change.reason}) if waits and change else {}
        return facts | {
            "procedure": procedure_label(plan.procedure),
            "cell": str(plan.cell.get("name", "")),
            "job": plan.job,
            "operator": plan.operator,
            "attended": "unattended" if plan.unattended else "attended",
            "step": ""
            if view.step is None
            else f"Step {view.step.number} of {view.step.of}: "
            + step_label(view.step.name, has_rail=view.has_rail),
            "points": log.counted,
            "planned": plan.points,
            "share": RunText(view).share_done(),
            "worked_s": round(view.elapsed_s),
            "left_s": None if view.remaining_s is None or not view.live else view.remaining_s,
            "prompt": ": ".join(str(prompt[key]) for key in ("title", "text") if prompt.get(key)),
            "rows": self._rows,
            "age_s": view.newest_age_s if view.live and view.newest is not None else None,
            "stale": view.newest_is_old or not view.live,
            "stale_after_s": Shown.STALE_S,
            "verdicts": [_verdict(key, each) for key, each in log.verdicts.items()],
            "alarms": [
                {
                    "code": alarm.code,
                    "severity": alarm.severity,
                    "title": alarm.title,
                    "text": with_labels(": ".join(filter(None, (alarm.where, alarm.found))), log),
                    "means": alarm.means,
                }
                for alarm in reversed(view.alarms)
            ],
            "last_word": last_word(log, self._folder).sentence if over else "",
        }

    def _newest_rows(self, view: RunView) -> list[dict[str, object]]:
        """Return the newest points, newest first."""
        log = view.log
        newest = reversed([*log.points.values()])
        points = [
            *islice((point for point in newest if point.id.group != CONTROL), self.MOST_POINTS)
        ]
        deviations = point_deviations(log, points, expanded_uncertainty_mm(log))
        rows: list[dict[str, object]] = []
        for point, deviation in zip(points, deviations, strict=True):
            state, tone = PointRow(point, deviation, state_of(log, point, deviation)).said()
            rows.append(
                {
                    "name": point.id.text(point.station),
                    "error_mm": None if deviation is None else deviation.error_mm,
                    "norm_mm": None if deviation is None else deviation.norm_mm,
                    "limit_mm": None if deviation is None else deviation.limit_mm,
                    "state": state,
                    "tone": tone.removeprefix("*"),
                }
            )
        return rows


def _verdict(key: str, verdict: Verdict) -> dict[str, object]:
    return {
        "name": verdict_label(key),
        "holds": verdict.holds,
        "outcome": verdict.outcome.text,
        "text": verdict.text,
    }
