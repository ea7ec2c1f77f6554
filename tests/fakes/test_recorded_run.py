"""Whether recordings can be replayed."""

from __future__ import annotations

from pathlib import Path

import pytest

from fakes.replay import recorded_cell
from fakes.replay.recorded_cell import without_dialect
from hilcell.cell.file import load_cell
from hilcell.wire.recording import CLOCK, Piece


@pytest.mark.parametrize(
    ("asked", "answer", "refused"),
    [
        (b"where?\r\n", b"1,2,3\r\n", ""),
        (b"where?\n", b"", ""),
        (b"", b"", ""),
        (b"MoveJoints(1,2)\0", b"[3004][1]\0", "the driver"),
        (b"<ask/>", b"<state/>", "the driver"),
        (b"where?\n", b"\x01\x00\x00\x10", "the device"),
        (b"\x02\n", b"1\n", "the driver"),
    ],
)
def test_a_wire_that_is_no_plain_lines_needs_a_dialect(
    asked: bytes, answer: bytes, refused: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell = load_cell("paper")
    pieces = {
        CLOCK: [Piece.of(0.0, 0, "now", bytes(8))],
        "robot": [Piece.of(1.0, 1, ">", asked), Piece.of(1.1, 1, "<", answer)],
    }
    paths = {name: Path(f"{name}.wire.jsonl") for name in pieces}
    assert [*without_dialect(cell, paths, pieces)] == []  # that of its driver is stated
    monkeypatch.setattr(recorded_cell, "dialects_of", lambda *_: {})
    found = [*without_dialect(cell, paths, pieces)]
    assert len(found) == bool(refused)
    for each in found:
        assert each.startswith(f"robot.wire.jsonl: the bytes of {refused} are")
        assert cell.robot.driver in each
