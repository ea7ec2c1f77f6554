"""Two runs side by side: what has drifted between two calibrations."""

from __future__ import annotations

from typing import Any

import msgspec
from textual.app import ComposeResult
from textual.content import Content

from hilcell.errors import HilcellError
from hilcell.tui.engine import process as engine
from hilcell.tui.screens.base import Page
from hilcell.tui.text.columns import Column, Row
from hilcell.tui.widgets.panel import Panel
from hilcell.tui.widgets.table import Rows

COLUMNS = (
    Column("where", 9),
    Column("what", 20),
    Column("first", 9, right=True),
    Column("second", 9, right=True),
    Column("change", 9, right=True),
    Column("limit", 7, right=True),
    Column("verdict", 9),
)
DIGITS = {"mm": 4, "deg": 5}


class ComparePage(Page):
    """Shows what `hilcell compare` says of two runs."""

    title_text = "Comparison"
    footer = ("stop", "quit")

    def __init__(self, first: str, second: str) -> None:
        super().__init__()
        self._first, self._second = first, second

    def body(self) -> ComposeResult:
        """Build the words and the rows."""
        yield Panel("told")
        yield Rows(COLUMNS, empty="reading both journals ...", plain=self.cell.glyphs.plain)

    def on_mount(self) -> None:
        """Compare."""
        super().on_mount()
        self.cell.background(self._compare())

    async def _compare(self) -> None:
        runs = str(self.cell.options.runs)
        words = ("compare", self._first, self._second, "--runs", runs, "--json")
        try:
            found = msgspec.json.decode(await engine.ask_hilcell(*words), type=dict[str, Any])
        except HilcellError:
            if self.here:
                self.query_one(Rows).empty = "nothing to compare"
                self.query_one(Rows).refresh()
            raise
        if self.here:
            self.panel("told").show(told(found))
            self.query_one(Rows).put([change_row(each) for each in found["changes"]])


def told(found: dict[str, Any]) -> Content:
    """Return which runs, in what they differ, and the verdict."""
    lines = [f"{found['first']}  ->  {found['second']}"]
    lines += [
        f"{each['key']}: {each['first'] or '-'} -> {each['second'] or '-'}"
        for each in found["settings"][:4]
    ]
    return Content.assemble("\n".join(lines), "\n", (str(found["verdict"]), "bold"))


def change_row(change: dict[str, Any]) -> Row:
    """Return one change; what lies beyond its limit stands out."""
    digits = DIGITS.get(change["unit"], 2)
    numbers = [
        "" if change[name] is None else f"{change[name]:{sign}.{digits}f}"
        for name, sign in (("first", ""), ("second", ""), ("change", "+"), ("limit", ""))
    ]
    what = f"{change['what']}, {change['unit']}"
    tone = "" if change["verdict"] in ("", "within") else "bad"
    cells = (change["place"], what, *numbers, change["verdict"])
    return Row(f"{change['place']}/{change['what']}", cells, tone)
