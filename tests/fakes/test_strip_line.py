"""The strip on a serial line of its own: what it answers to the sensor's commands."""

from __future__ import annotations

from contextlib import closing

from fakes.faults import Faults
from fakes.site import Site
from fakes.strip import StripLine
from fakes.time import CellTime
from fakes.truth.cell_truth import CellTruth
from hilcell.cell.file import Cell


def test_a_head_that_misses_its_strip_says_so_in_its_register(cell: Cell) -> None:
    faults = Faults()
    truth = CellTruth(cell, 1, CellTime(), faults)
    with closing(StripLine(Site(cell, truth, faults, truth.time), {})) as line:
        line.answers(b"Z")
        assert line.answers(b"X") == ([b"0x00>\r"], b"")
        faults.set("rail.missing_magnet")
        line.answers(b"Z")
        assert line.answers(b"X") == ([b"0x01>\r"], b"")
        line.answers(b"Z")
        assert line.answers(b"XA") == ([b"0x00>\r"], b"A")
