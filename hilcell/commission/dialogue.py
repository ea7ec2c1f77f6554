"""Questions to a person, and messages; a terminal and the screen show them in their own ways.

At a terminal a run that waits takes its lines from the same queue.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from queue import Empty, Queue
from types import MappingProxyType
from typing import NamedTuple, TypeVar

from hilcell.commission.record import StepRecord
from hilcell.errors import HilcellError

T = TypeVar("T")
TRIES = 5


class Question(NamedTuple):
    """One question; ``choices``: the answers with their texts; ``motion``: something moves then."""

    text: str
    default: str = ""
    choices: Mapping[str, str] = MappingProxyType({})
    motion: bool = False


class Dialogue(ABC):
    """Asks, parses and counts; ``real``: motions need the whole word "yes"."""

    def __init__(self) -> None:
        self.questions = 0
        self.real = True

    @abstractmethod
    def say(self, text: str) -> None:
        """Tell one line."""

    @abstractmethod
    def begin(self, step: str, title: str, number: int, of: int) -> None:
        """Tell which step begins."""

    @abstractmethod
    def show(self, record: StepRecord, lines: Sequence[str], written: Sequence[str]) -> None:
        """Show what a step has proved, ``lines`` in short, and what it has ``written``."""

    @abstractmethod
    def answered(self, question: Question) -> str:
        """Put a question and return the answer without outer blanks.

        Raises `HilcellError` where none can come. To a question of a motion it was typed after it.
        """

    def ask(self, question: str, parse: Callable[[str], T], default: str = "") -> T:
        """Return a parsed answer; asks again where ``parse`` raises `ValueError`."""
        return self._parsed(Question(question, default), parse)

    def choose(self, question: str, choices: Mapping[str, str], default: str = "") -> str:
        """Return one of the choices, by its number or its name; ``choices`` have their texts."""
        names = list(choices)

        def parse(answer: str) -> str:
            if answer in choices:
                return answer
            if answer.isdecimal() and 1 <= int(answer) <= len(names):
                return names[int(answer) - 1]
            raise ValueError(f"expected 1 to {len(names)}, or a name, got {answer!r}")

        default = default or (names[0] if len(names) == 1 else "")
        return self._parsed(Question(question, default, choices), parse)

    def agree(self, question: str) -> bool:
        """Return whether the person agrees to a motion."""
        self.questions += 1
        return self.agrees(self.answered(Question(question, motion=True)))

    @property
    def how(self) -> str:
        """Return how a person agrees."""
        return 'type "yes" to continue' if self.real else "Enter or y continues"

    def agrees(self, line: str) -> bool:
        return line.strip().lower() in (("yes",) if self.real else ("", "y", "yes"))

    def _parsed(self, question: Question, parse: Callable[[str], T]) -> T:
        self.questions += 1
        for _ in range(TRIES):
            try:
                return parse(self.answered(question) or question.default)
            except ValueError as error:
                self.say(f"{error}")
        raise HilcellError(
            f"{question.text} has no valid answer after {TRIES} tries", code="HC-C40"
        )


class TypedDialogue(Dialogue):
    """Asks on ``tell`` and takes answers from ``lines``, None at their end."""

    def __init__(self, lines: Queue[str | None], tell: Callable[[str], object]) -> None:
        super().__init__()
        self._lines, self._tell = lines, tell
        self.over = False  # the input has ended

    def say(self, text: str) -> None:
        self._tell(text)

    def begin(self, step: str, title: str, number: int, of: int) -> None:
        self.say(f"step {number} of {of}, {step}: {title}")

    def show(self, record: StepRecord, lines: Sequence[str], written: Sequence[str]) -> None:
        for line in (*lines, *written):
            self.say(f"  {line}")

    def answered(self, question: Question) -> str:
        for number, (name, text) in enumerate(question.choices.items(), start=1):
            self.say(f"  {number}  {name}: {text}")
        default = f" [{question.default}]" if question.default else ""
        how = f" ({self.how}; another answer moves nothing)" if question.motion else ""
        self.say(f"{question.text}{default}{how}")
        if question.motion:
            self.drop_typed_ahead()
        return self._line()

    def drop_typed_ahead(self) -> None:
        """Forget what was typed before a question of which real devices move."""
        while self.real and not self.over:
            try:
                self.over = self._lines.get_nowait() is None
            except Empty:
                return

    def waiting_line(self, limit_s: float) -> str | None:
        """Return a typed line, None if none comes in time or input has ended."""
        if self.over:
            return None
        try:
            line = self._lines.get(timeout=limit_s)
        except Empty:
            return None
        self.over = line is None
        return line

    def _line(self) -> str:
        line = None if self.over else self._lines.get()
        if line is None:
            self.over = True
            raise HilcellError(
                "the input has ended; the same command goes on with the first unproved step",
                code="HC-C40",
            )
        return line.strip()


def number(low: float, high: float, unit: str) -> Callable[[str], float]:
    """Return a parser of a number within limits."""

    def parse(answer: str) -> float:
        try:
            value = float(answer)
        except ValueError:
            unit_of = f" in {unit}" if unit else ""
            raise ValueError(f"expected a number{unit_of}, got {answer!r}") from None
        if not low <= value <= high:
            raise ValueError(f"expected {low:g} .. {high:g} {unit}".rstrip() + f", got {value:g}")
        return value

    return parse


def word(what: str) -> Callable[[str], str]:
    """Return a parser of a text that is not empty."""

    def parse(answer: str) -> str:
        if not answer:
            raise ValueError(f"expected {what}")
        return answer

    return parse
