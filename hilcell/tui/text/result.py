"""A run's result: in the place of the digits where it has no validation, and on the report's page.

A pose test shows its worst AP and RP large, a re-check what to do with the calibration. Every other
procedure shows its own table, as ``hilcell show`` prints it. No sentence and no number is cut.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from operator import attrgetter
from typing import NamedTuple, Self, TypeVar

import msgspec
from textual.content import Content

from hilcell.calibration.iso9283 import Angles, PoseTest
from hilcell.calibration.recheck import KIND as RECHECK
from hilcell.calibration.recheck import CheckedPose, RecheckResult
from hilcell.cell.devices import load_entry
from hilcell.clean import harmless
from hilcell.errors import HilcellError
from hilcell.journal.log import Log
from hilcell.journal.words import id_of, in_words, procedure_words
from hilcell.model.verdicts import AD, AP, AP_ANGLES, ISO, RD, RP, RP_ANGLES
from hilcell.present.table import Column, Named, Table
from hilcell.tui.engine.run_view import RunView
from hilcell.tui.layout import BLANK, Cell, Col, Drawing, Grid, Lines, Stack, Text, facts_grid
from hilcell.tui.terminal.capabilities import Glyphs
from hilcell.tui.text.digits import figure
from hilcell.tui.text.head import NEXT, Figure, Head, gravest, head_lines
from hilcell.typed import Json, typed

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Result:
    """The findings of a run; the head has no words where nothing large is said."""

    head: Head
    text: str
    table: Table

    @classmethod
    def of_test(cls, test: PoseTest, *, passed: bool) -> Self:
        """Return that of a pose test: its worst AP and RP, and each pose."""
        worst, limits, turned = test.worst, test.limits, test.orientation
        ap_mm, rp_mm = limits.get(AP.limit), limits.get(RP.limit)
        figures = (
            Figure("worst AP_p, mm", worst.ap_mm, f"at {worst.ap_pose}", ap_mm, worst.ap_u95_mm),
            Figure("worst RP_l, mm", worst.rp_mm, f"at {worst.rp_pose}", rp_mm, worst.rp_u95_mm),
        )
        rows = [
            _PoseRow(
                name,
                figure(each.ap_mm),
                figure(each.ap_u95_mm),
                figure(each.rp_mm),
                figure(each.rp_u95_mm),
                *_worst_angles(turned.get(name)),
                "pass" if test.keeps(name) else "FAIL",
            )
            for name, each in test.poses.items()
        ]
        columns = [*POSES, *(ANGLES if turned else ())]
        if limits:
            columns.append(Column("verdict", attrgetter("verdict")))
            angles = (_limit(limits.get(of.limit)) for of in (AP_ANGLES, RP_ANGLES))
            rows.append(_PoseRow("limit", _limit(ap_mm), "", _limit(rp_mm), "", *angles))
        words, stated, role = (("ISO",), "no limits stated", "label")
        if test.limits:
            words, stated, role = (
                (("PASS",), "within its limits", "passed")
                if passed
                else (("FAIL",), "not within its limits", "fault")
            )
        return cls(Head(words, stated, role, figures), _distance_words(test), Table(columns, rows))

    @classmethod
    def of_recheck(cls, found: RecheckResult, log: Log) -> Self:
        """Return that of a re-check: what to do, and each target, the worst first."""
        worst = sorted(found.poses, key=lambda each: -gravest(each.error_mm))
        columns: list[Column[CheckedPose]] = [
            Column("worst first", lambda each: id_of(each.pose, log).short),
            Column("predicted below", lambda each: figure(each.bound_mm), "mm", "s"),
            Column("now", lambda each: figure(each.error_mm), "mm", "s"),
            Column("less the base's motion", lambda each: figure(each.left_mm), "mm", "s"),
        ]
        limits_mm = found.mean_tolerance_mm, found.max_tolerance_mm
        at = id_of(worst[0].pose, log).short if worst else "its target"
        figures = (
            Figure("mean |e| now, mm", found.mean_mm, "all", limits_mm[0], found.mean_U_mm),
            Figure("largest |e| now, mm", found.max_mm, at, limits_mm[1], found.max_U_mm),
        )
        words = {
            "valid": (("STILL", "VALID"), "still valid", "passed"),
            "update": (("UPDATE",), "base moved, updated", "ask"),
            "redo": (("REDO",), "calibrate again", "fault"),
        }
        head = Head(*words[found.verdict], figures)
        return cls(head, found.text, Table(columns, worst))


def result_of(view: RunView) -> Result | None:
    """Return the result of a run that has come to its end; None for every other, or for none."""
    if view.state not in ("done", "intolerant") or view.log.plan is None:
        return None
    found = None if view.log.end is None else view.log.result
    if not isinstance(found, dict):
        return None
    test = _converted(found.get(ISO), PoseTest)
    if test is not None and test.poses:
        return Result.of_test(test, passed=view.state == "done")
    checked = _converted(found.get(RECHECK), RecheckResult)
    if checked is not None:
        return Result.of_recheck(checked, view.log)
    table, text = own_words(view.log.plan.procedure, found)
    nothing = "" if table else "Finished. This procedure measures nothing that is judged."
    return Result(Head((), "", "label", ()), text or nothing, table)


def _converted(found: object, kind: type[T]) -> T | None:
    """Return a part of a result; None of another procedure's, or of another version's."""
    try:
        return typed(found, kind)
    except msgspec.ValidationError:
        return None


def own_words(name: str, result: Json) -> tuple[Table, str]:
    """Return a procedure's own table and words of a result; nothing of what it cannot read."""
    if not result:
        return Table((), ()), ""
    try:
        procedure = load_entry("procedures", name)
        table: Table = procedure.table(result)
        table.texts()  # raises where a value is not of its column
        return table, procedure.words(result)
    except (HilcellError, LookupError, TypeError, ValueError, AttributeError):
        return Table((), ()), ""  # of another version, or of a procedure that is not installed here


# -- a pose test -----------------------------------------------------------------------------------


class _PoseRow(NamedTuple):
    """A pose's figures as they are shown, or their limits."""

    name: str
    ap: str
    ap_U: str
    rp: str
    rp_U: str
    ap_angle: str
    rp_angle: str
    verdict: str = ""


POSES = (
    Column[_PoseRow]("pose", attrgetter("name")),
    Column[_PoseRow](AP.symbol, attrgetter("ap"), "mm", "s"),
    Column[_PoseRow]("U", attrgetter("ap_U"), "mm", "s"),
    Column[_PoseRow](RP.symbol, attrgetter("rp"), "mm", "s"),
    Column[_PoseRow]("U", attrgetter("rp_U"), "mm", "s"),
)
ANGLES = (
    Column[_PoseRow](AP_ANGLES.symbol, attrgetter("ap_angle"), "°", "s"),
    Column[_PoseRow](RP_ANGLES.symbol, attrgetter("rp_angle"), "°", "s"),
)


def _distance_words(test: PoseTest) -> str:
    found, stated = test.distance, ((of.key.upper(), test.limits.get(of.limit)) for of in (AD, RD))
    limits = [f"{name} {limit_mm:.3f}" for name, limit_mm in stated if limit_mm is not None]
    said = f"; limits {', '.join(limits)} mm" if limits else ""
    return (
        f"distance {found.start}-{found.to}: AD {found.ad_mm:+z.3f} mm (U {found.ad_u95_mm:.3f}), "
        f"RD ±{found.rd_mm:.3f} mm (U {found.rd_u95_mm:.3f}){said}"
    )


def _worst_angles(found: Angles | None) -> tuple[str, str]:
    """Return the largest AP and RP of a pose's angles, as far as they were measured."""
    parts = ({}, {}) if found is None else (found.ap_deg, found.rp_deg)
    ap, rp = (f"{max(map(abs, each.values())):.4f}" if each else "-" for each in parts)
    return ap, rp


def _limit(limit_mm: float | None) -> str:
    return "-" if limit_mm is None else f"{limit_mm:.3f}"


# -- drawing ---------------------------------------------------------------------------------------


def result_lines(view: RunView, found: Result, glyphs: Glyphs) -> Lines:
    """Return the word and its figures, the sentence, and as many rows of the table as fit."""
    table = sheet_lines(found.table, view.log)

    def draw(width: int, height: int) -> list[Content]:
        rows = height or 40  # which hold most results whole
        lines = head_lines(view, found.head, glyphs, width, rows)
        if found.text:
            said: list[Cell] = ["", (harmless(found.text), "$label")]
            lines += Grid([said], Col(), Col(grows=True, wraps=True)).lines(width)
        lines += table.lines(width)
        if len(lines) > rows:
            more = Content.styled(" o report: all of the table", "$label")
            lines = [*lines[: max(rows - 1, 0)], more]
        else:
            lines.append(Content.assemble((" next: ", "$label"), NEXT))
        return [line.truncate(width) for line in lines]

    return Drawing((id(found), glyphs.plain), draw)


NAMES = {  # of the summary, by the name shown
    "operator": "operator", "job": "job", "points": "points", "state": "state",
    "verdict": "verdict", "calibration": "stage", "seed": "seed",
    "accepted": "accepted", "link_warning": "warning", "fault": "fault",
}  # fmt: skip


def report_lines(found: Mapping[str, object], log: Log | None) -> Lines:
    """Return the facts of a run, its own table and its sentence."""
    procedure = str(found.get("procedure", ""))
    facts = [("run", str(found.get("run", ""))), ("procedure", procedure_words(procedure))]
    facts += [("cell", str(found.get("cell", "")))]
    facts += [("simulated", "yes, no device moved" if found.get("simulated") else "no")]
    facts += [(shown, _words(found[name])) for name, shown in NAMES.items() if found.get(name)]
    standing = found.get("standing")
    if isinstance(standing, Mapping):
        facts.append(("calibration", str(standing.get("text", ""))))
    parts: list[Lines | Text] = [facts_grid((name, harmless(text)) for name, text in facts)]
    result = found.get("result")
    if found.get("state") == "finished" and isinstance(result, dict):
        table, text = own_words(procedure, result)
        parts += [BLANK, sheet_lines(table, log)] if table else []
        parts += [BLANK, harmless(text)] if text else []
    return Stack(*parts)


def _words(value: object) -> str:
    """Return a value as a person reads it; names of states have no underscores."""
    if isinstance(value, list):
        return "; ".join(map(_words, value))
    text = str(value)
    return text if " " in text else text.replace("_", " ")


GAP = 2
WIDEST = 30  # columns of a cell; a longer text wraps


def sheet_lines(table: Table, log: Log | None = None) -> Lines:
    """Return the table in as many blocks as it needs, each with its header.

    Names of the program, and keys of the points of ``log``, are in words.
    """
    shown = [table.headers, *table.texts("-")]
    for texts, values in zip(shown[1:], table.rows, strict=True):
        for at, value in enumerate(values):
            text = value.words if isinstance(value, Named) else texts[at]
            texts[at] = text if log is None else in_words(text, log)
    shown = [[harmless(cell) for cell in row] for row in shown]
    columns = [list(column) for column in zip(*shown, strict=True)]

    def draw(width: int, height: int) -> list[Content]:
        widths = [max(map(len, column)) for column in columns]
        if sum(widths) + GAP * len(widths) > width:  # headers wrap before columns go on below
            widths = [max(map(len, [*head.split(), *cells])) for head, *cells in columns]
        widths = [max(min(each, WIDEST, width - 2), 1) for each in widths]
        lines: list[Content] = []
        blocks: list[list[int]] = [[0]] if widths else []  # columns; the first begins each block
        for n in range(1, len(widths)):
            used = sum(widths[m] + GAP for m in blocks[-1])
            if used + widths[n] > width - 1 and len(blocks[-1]) > 1:
                blocks.append([0])
            blocks[-1].append(n)
        for block in blocks:
            cols = (Col(most=widths[n], right=n > 0, wraps=True) for n in block)
            rows = [[row[n] for n in block] for row in shown]
            grid = Grid(rows, *cols, gap=GAP, styles={0: "$label on $panel"})
            lines += [line.pad_left(1) for line in grid.lines(width - 1)]
        return lines

    return Drawing(shown, draw)
