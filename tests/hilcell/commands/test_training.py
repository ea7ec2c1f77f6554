from __future__ import annotations

import random

import pytest

from hilcell.commands.cell import Trainer
from hilcell.ports import Exercise


class Cell:
    exercises = (Exercise("the E-stop was pressed", "HC-B10"), Exercise("a beam", "HC-T10"))

    def __init__(self) -> None:
        self.done: list[str] = []

    def strike(self, exercise: Exercise) -> None:
        self.done.append(exercise.title)

    def heal(self) -> None:
        self.done.append("healed")


@pytest.fixture
def cell() -> Cell:
    return Cell()


@pytest.fixture
def trainer(cell: Cell) -> Trainer:
    return Trainer(cell, random.Random(1))


def test_a_fault_is_explained_only_afterwards(
    cell: Cell, trainer: Trainer, capsys: pytest.CaptureFixture[str]
) -> None:
    assert trainer.take("1\n")
    assert "E-stop" not in capsys.readouterr().err
    assert trainer.take("\n")
    said = capsys.readouterr().err
    assert "the E-stop was pressed" in said
    assert "HC-B10" in said
    assert cell.done == ["the E-stop was pressed", "healed"]


def test_a_surprise_is_one_of_the_menu_and_only_one_at_a_time(cell: Cell, trainer: Trainer) -> None:
    assert trainer.take("\n")
    assert cell.done[0] in [each.title for each in cell.exercises]
    assert trainer.take("2\n")  # another number is an answer now
    assert cell.done[1:] == ["healed"]


@pytest.mark.parametrize("word", ["0", "3", "x", "-1", "1.0", "\u0661\u0662", "9" * 30])
def test_anything_else_is_helped(cell: Cell, trainer: Trainer, word: str) -> None:
    assert trainer.take(word)
    assert cell.done == []


@pytest.mark.parametrize("word", ["q", " Q \n"])
def test_it_ends_by_q(trainer: Trainer, word: str) -> None:
    assert not trainer.take(word)


def test_the_answer_is_not_pushed_out_of_view_by_the_menu(
    trainer: Trainer, capsys: pytest.CaptureFixture[str]
) -> None:
    trainer.take("1\n")
    capsys.readouterr()
    trainer.take("\n")
    said = capsys.readouterr().err
    assert "a beam" not in said
    trainer.take("m\n")
    assert "a beam" in capsys.readouterr().err
