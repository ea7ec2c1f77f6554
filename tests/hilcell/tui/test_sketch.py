"""The plan from above: to scale, every nest named, x right and y up."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from hilcell.cell.file import load_cell
from hilcell.geometry.frames import apply
from hilcell.tui.text.prompt import Place, Site

CELLS = ("paper", "six-r", "hard", "replay")


def site(cell_name: str, wanted: str, done: str = "") -> Site:
    cell = load_cell(cell_name)
    layout, base = cell.layout, cell.layout.nominal_base(cell.station[-1].rail_mm)
    slide = {n.name: _xy(apply(base, n.xyz_mm[None])[0]) for n in layout.slide}
    standing = {n.name: _xy(n.xyz_mm) for n in layout.standing}
    nests = slide if wanted in slide else standing
    return Site(
        nests=nests, done=frozenset(filter(None, [done])), wanted=wanted, wanted_mm=nests[wanted],
        robot_mm=_xy(base[:3, 3]), tracker_mm=_xy(cell.tracker.pose.matrix()[:3, 3]),
        along=layout.rail_direction[:2],
        stations={s.name: _xy(layout.nominal_base(s.rail_mm)[:3, 3]) for s in cell.station},
    )  # fmt: skip


def _xy(xyz: np.ndarray) -> Place:
    return float(xyz[0]), float(xyz[1])


def drawn(found: Site, columns: int = 46, rows: int = 11) -> list[str]:
    return [line.plain for line in found.drawn(columns, rows)]


@pytest.mark.parametrize("name", CELLS)
def test_every_nest_is_named_once_and_the_wanted_one_is_there(name: str) -> None:
    layout = load_cell(name).layout
    for nests in (layout.standing, layout.slide):
        for nest in nests:
            lines = drawn(site(name, nest.name))
            assert len(lines) == 11
            assert {len(line) for line in lines} == {46}
            text = "\n".join(lines)
            assert all(text.count(f" {each.name} ") == 1 for each in nests), text


@pytest.mark.parametrize("name", CELLS)
def test_right_is_right_and_up_is_up(name: str) -> None:
    found = site(name, load_cell(name).layout.floor[0].name)
    lines = drawn(found)
    at = {n: _at(lines, n) for n in found.nests}
    for one, other in combinations(found.nests, 2):
        (x, y), (u, v) = found.nests[one], found.nests[other]
        if abs(x - u) > 1000.0:  # names stand beside their nests
            assert (at[one][0] > at[other][0]) == (x > u)
        if abs(y - v) > 1000.0:
            assert (at[one][1] < at[other][1]) == (y > v)


def _at(lines: list[str], name: str) -> tuple[int, int]:
    (row,) = [n for n, line in enumerate(lines) if f" {name} " in line]
    return lines[row].index(f" {name} "), row


def test_the_scale_is_that_of_the_drawing() -> None:
    found = site("paper", "F2")
    lines = drawn(found)
    bar = lines[-1]
    assert "┤ 1 m   x ►  y up" in bar
    columns = bar.index("┤") - bar.index("├")
    apart = abs(lines[_at(lines, "F1")[1]].index("○") - _at(lines, "F2")[0] - 2)
    assert abs(apart / 1.5 - columns) <= 1.0


def test_what_is_done_is_filled_and_the_tracker_has_its_beam() -> None:
    text = "\n".join(drawn(site("paper", "F2", done="F1")))
    assert "● F1" in text
    assert "○ F3" in text
    assert "▲" in text
    assert " tracker " in text
    assert "· ·" in text
    assert "─ S300 " in text
    assert "│ │" in text


def test_a_tracker_beyond_the_edge_is_drawn_at_it() -> None:
    lines = drawn(site("paper", "P1"))
    (row,) = [line for line in lines if "▲" in line]
    assert row.endswith("▲")


def test_a_robot_on_the_floor_has_no_rail() -> None:
    found = site("paper", "F2")
    parts = {name: getattr(found, name) for name in Site.__slots__}
    parts["along"] = (0.0, 0.0)
    bare = Site(**parts)
    assert not any("│" in line for line in drawn(bare))


def test_where_there_is_no_room_there_is_no_drawing() -> None:
    found = site("paper", "F2")
    assert found.drawn(Site.LEAST_COLUMNS - 1, 11) == []
    assert found.drawn(46, Site.LEAST_ROWS - 1) == []
    for columns, rows in ((Site.LEAST_COLUMNS, Site.LEAST_ROWS), (100, 30)):
        lines = drawn(found, columns, rows)
        assert len(lines) == rows
        assert {len(line) for line in lines} == {columns}
        assert " F2 " in "\n".join(lines)
