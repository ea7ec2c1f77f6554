"""The table that draws what is in tracker_text: ten thousand rows, a cursor, and following."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest
from rich.cells import cell_len
from textual.app import App, ComposeResult
from textual.pilot import Pilot

from hilcell.tui.themes import PALETTES
from hilcell.tui.widgets import Column, Table

pytestmark = pytest.mark.waits

MANY = 10_000
HEIGHT = 20  # rows in tracker_text, under the header
Row = tuple[str, str, str]  # key, name, length
COLUMNS: tuple[Column[Row], ...] = (
    Column("name", 10, lambda row: row[1]),
    Column("mm", 8, lambda row: row[2], right=True),
)


def rows_of(count: int, start: int = 0) -> list[Row]:
    return [(f"k{n}", f"run {n}", f"{n:.2f}") for n in range(start, start + count)]


class TableApp(App[None]):
    """A table alone, which writes down what it says."""

    def __init__(self, *, follow: bool = False, plain: bool = False) -> None:
        super().__init__()
        self.set_class(plain, "plain")
        self.rows: Table[Row] = Table(
            COLUMNS, lambda row: row[0], empty="nothing here", tone=lambda _: "fault"
        )
        self.rows.follow = follow
        self.chosen: list[str] = []
        self.moved: list[str] = []
        self.register_theme(PALETTES[0].theme())
        self.theme = PALETTES[0].name

    CSS = "Table { height: 21; } Table > .table--cursor { text-style: bold; }"

    def compose(self) -> ComposeResult:
        yield self.rows

    def on_mount(self) -> None:
        self.rows.focus()

    def on_table_row_selected(self, message: Table.RowSelected) -> None:
        self.chosen.append(message.key)

    def on_table_row_highlighted(self, message: Table.RowHighlighted) -> None:
        self.moved.append(message.key)

    def seen(self) -> list[str]:
        """Return the lines in tracker_text, the header first."""
        lines = [self.rows.render_line(y).text.rstrip() for y in range(HEIGHT + 1)]
        return [line for line in lines if line]


Act = Callable[[TableApp, Pilot[None]], Awaitable[None]]


def run_app(act: Act, table: TableApp | None = None) -> TableApp:
    app = table or TableApp()

    async def run() -> None:
        async with app.run_test(size=(60, 24)) as pilot:
            await pilot.pause()
            await act(app, pilot)

    asyncio.run(run())
    return app


def test_ten_thousand_rows_are_paged_to_their_end() -> None:
    async def act(app: TableApp, pilot: Pilot[None]) -> None:
        app.rows.show_rows(rows_of(MANY))
        assert app.seen()[:2] == [" name             mm", "►run 0          0.00"]
        await pilot.press("end")
        assert app.rows.key == f"k{MANY - 1}"
        assert app.seen()[-1] == "►run 9999    9999.00"
        assert len(app.seen()) == HEIGHT + 1
        await pilot.press("pageup", "up", "down")
        assert app.rows.cursor == MANY - 1 - (HEIGHT - 1)
        await pilot.press("home", "pagedown")
        assert app.rows.cursor == HEIGHT - 1
        await pilot.press("home", "up")
        assert app.rows.cursor == 0

    run_app(act)


def test_the_cursor_stays_on_its_row_when_rows_come_before_it() -> None:
    async def act(app: TableApp, pilot: Pilot[None]) -> None:
        app.rows.show_rows(rows_of(50, start=50))
        await pilot.press("down", "down")
        assert app.rows.key == "k52"
        app.rows.show_rows(rows_of(100))
        assert (app.rows.key, app.rows.cursor) == ("k52", 52)
        await pilot.pause()
        assert any(line.startswith("►run 52") for line in app.seen())

    run_app(act)


def test_the_cursor_stays_near_when_its_row_goes() -> None:
    async def act(app: TableApp, pilot: Pilot[None]) -> None:
        app.rows.show_rows(rows_of(50))
        await pilot.press("end")
        app.rows.show_rows(rows_of(10))
        assert app.rows.key == "k9"
        app.rows.show_rows([])
        assert app.rows.key == ""
        assert app.seen()[-1] == " nothing here"
        await pilot.press("down", "end", "pagedown", "enter")
        assert app.chosen == [""]
        app.rows.show_rows(rows_of(3))
        assert app.rows.key == "k0"

    run_app(act)


def test_following_keeps_to_the_end_until_one_looks_back() -> None:
    async def act(app: TableApp, pilot: Pilot[None]) -> None:
        for count in (1, 5, 40):
            app.rows.show_rows(rows_of(count))
            assert app.rows.key == f"k{count - 1}"
        await pilot.press("up")
        app.rows.show_rows(rows_of(60))
        assert app.rows.key == "k38"
        await pilot.press("end")
        app.rows.show_rows(rows_of(80))
        assert app.rows.key == "k79"
        await pilot.pause()
        assert app.seen()[-1].startswith("►run 79")

    run_app(act, TableApp(follow=True))


def test_it_says_what_is_chosen_and_where_the_cursor_is() -> None:
    async def act(app: TableApp, pilot: Pilot[None]) -> None:
        app.rows.show_rows(rows_of(5))
        await pilot.press("down", "enter", "down")
        await pilot.pause()

    app = run_app(act)
    assert (app.chosen, app.moved) == (["k1"], ["k1", "k2"])


HOSTILE = [
    "[/nope]", "[@click=app.quit]x[/]", "\x1b[31mred", "\x9b31m", "\u202eevil", "\u200bzero",
    "a\nb", "\r\x08\x07", "x" * 5000, "漢字漢字漢字漢字", "👩‍🔧 done",
    "e\u0301" * 8, "\ud800", "[b",
]  # fmt: skip


@pytest.mark.parametrize("plain", [False, True])
def test_cells_are_plain_text_and_stay_in_their_columns(plain: bool) -> None:
    async def act(app: TableApp, pilot: Pilot[None]) -> None:
        app.rows.show_rows([(text, text, "1.25") for text in HOSTILE])
        for number in range(len(HOSTILE)):
            line = app.rows.render_line(number + 1)
            assert line.cell_length == app.rows.size.width
            assert not set(line.text) & set("\x1b\x9b\u202e\u200b\n\r\x08\x07\ud800")
            assert line.text.isascii() or not plain
            before, _, _ = line.text.partition("1.25")
            assert cell_len(before) == 1 + 10 + 1 + 4
            await pilot.press("enter", "down")

    assert run_app(act, TableApp(plain=plain)).chosen == HOSTILE
