"""The calibration of a run, made, changed, judged or revoked, and its verdict, from its journal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

import msgspec

from hilcell.journal.journal import Record
from hilcell.model.events import CalibrationRevoked, CalibrationUsed
from hilcell.typed import typed

if TYPE_CHECKING:
    from hilcell.journal.log import Log

VALIDATION = "validation."  # the key of a verdict is this and the place
SINCE = "since"  # the key of the verdict on what has changed since the calibration before
JUDGING = (VALIDATION, "iso9283", "targets")  # verdicts on the robot against stated limits
OUTCOMES = {  # of a judged figure, a point or a station, in the words that runs have
    "accepted": "in tolerance",
    "undecided": "undecided",
    "rejected": "out of tolerance",
}
VERDICTS = {"accepted": "pass", "undecided": "undecided", "rejected": "fail"}  # the same, short
NOT_JUDGED = (
    "measured",
    "done",
)  # runs that judged nothing, and those that measured nothing either
SUSPECTED = "suspected"  # of a run that suspects a cause, alone or behind its outcome
REFUSED = 2  # the exit code of a run that nothing moved in
RECHECKED = {"valid": "still valid", "update": "updated", "redo": "calibrate again"}

Kind = Literal["", "made", "base", "targets", "touch"]


class CalibrationFacts(msgspec.Struct, frozen=True):
    """``kind`` says how a run that finishes comes to a calibration: measured, or one of before with
    base, targets or a station's base changed; "" is none. ``used`` is the run whose calibration it
    took, ``validated`` whether places were validated and all hold, ``undecided`` that some are
    neither in nor out of tolerance and none is out, ``redo`` that a re-check found the used one to
    hold no more, ``doubt`` what would explain an update of it as well. ``revoked`` is why somebody
    has revoked its own. ``suspected`` says that the run suspects a cause that was not cleared,
    ``judged`` that it held the robot against limits, ``verdict`` is that of all verdicts in words,
    "" where nothing was judged and no check failed. ``changed_since`` is the run of a calibration
    that this one differs from, where nothing else is against it: a person says which is right.
    """

    kind: Kind = ""
    used: str = ""
    validated: bool = False
    undecided: bool = False
    redo: bool = False
    doubt: str = ""
    revoked: str = ""
    suspected: bool = False
    judged: bool = False
    verdict: str = ""
    changed_since: str = ""


class _Verdict(msgspec.Struct):
    holds: bool
    verdict: str = ""
    outcome: str | None = None
    doubt: str = ""
    suspected: list[str] = []
    before: str = ""


class CalibrationReader:
    """Gathers the facts from the records of a journal, in their order."""

    def __init__(self) -> None:
        self._verdicts: dict[str, _Verdict] = {}
        self._used = self._revoked = ""
        self.moved = False  # the cell

    def take(self, record: Record) -> None:
        """Add one record; raises `msgspec.ValidationError`."""
        self.moved = self.moved or record.kind == "intent"
        if record.kind == "verdict":
            self.judge(record.key, record.body)
            return
        match record.fact if record.kind == "event" else None:
            case CalibrationUsed(run=run):
                self._used = run
            case CalibrationRevoked(reason=reason):
                self._revoked = reason

    def judge(self, key: str, body: Mapping[str, Any]) -> None:
        """Add a verdict; raises `msgspec.ValidationError`."""
        self._verdicts[key] = typed(body, _Verdict)

    @property
    def facts(self) -> CalibrationFacts:
        """Return what the records have said."""
        rechecked = self._verdicts.get("recheck", _Verdict(holds=True))
        places = [v for key, v in self._verdicts.items() if key.startswith(VALIDATION)]
        failed = [each.outcome for each in places if not each.holds]
        undecided = bool(failed) and set(failed) == {"undecided"}
        kind, validated = self._kind(rechecked.verdict), bool(places) and not failed
        broken = [each for each in self._verdicts.values() if not each.holds]
        since = self._verdicts.get(SINCE)
        changed = since.before if since is not None and broken == [since] else ""
        suspected = any(each.suspected for each in broken)
        judged = any(key.startswith(JUDGING) for key in self._verdicts)
        if rechecked.verdict in RECHECKED:
            verdict = RECHECKED[rechecked.verdict]
        elif undecided:
            verdict = OUTCOMES["undecided"]
        elif any(not each.suspected for each in broken):
            verdict = OUTCOMES["rejected"]
        elif kind == "made" and not validated:
            verdict = "not validated"
        else:
            verdict = OUTCOMES["accepted"] if judged and not suspected else ""
        return CalibrationFacts(
            kind, self._used, validated, undecided, rechecked.verdict == "redo",
            rechecked.doubt, self._revoked, suspected, judged,
            "; ".join(filter(None, (verdict, SUSPECTED if suspected else ""))),
            changed,
        )  # fmt: skip

    def _kind(self, recheck: str) -> Kind:
        """Return the kind, as `Log.calibrates` and `calibration_after` tell them apart."""
        if "fit" in self._verdicts:
            return "made"
        if "touch" in self._verdicts:
            return "touch"
        if "targets" in self._verdicts:
            return "targets" if self._verdicts["targets"].holds else ""
        return "base" if recheck == "update" else ""


def outcome(facts: CalibrationFacts, state: str, code: int | None, points: int) -> str:
    """Return in a word how a run in ``state`` with exit ``code`` came out; "" without an end.

    List of runs, history, screen and report say this word. A run that judged nothing has
    "measured", or "done" where it measured nothing either.
    """
    if code is None:
        return ""
    if code == REFUSED:  # the devices may have been asked, and nothing moved
        return "refused"
    if state == "idle":
        return "not begun"
    if state != "finished":
        return state
    if code and facts.verdict in ("", OUTCOMES["accepted"]):
        return OUTCOMES["rejected"]
    return facts.verdict or NOT_JUDGED[0 if points else 1]


def facts_of_verdicts(log: Log) -> CalibrationFacts:
    """Return what the verdicts of a log say."""
    reader = CalibrationReader()
    for key, body in log.verdicts.items():
        reader.judge(key, body)
    return reader.facts


def run_outcome(log: Log) -> str:
    """Return how the run of a log came out, in the word of `outcome`."""
    code = None if log.end is None else log.end.exit
    return outcome(facts_of_verdicts(log), log.state, code, len(log.points))
