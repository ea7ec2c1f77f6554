"""Questions to the person at the terminal; a run that waits takes its lines from the same queue."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from queue import Empty, Queue
from typing import TypeVar

from hilcell.errors import HilcellError

T = TypeVar("T")
TRIES = 5


class Dialogue:
    """Asks on ``say`` and takes answers from ``lines``, None at their end.

    ``questions`` counts what was asked; ``real``: motions need the whole word "yes".
    """

    def __init__(self, lines: Queue[str | None], say: Callable[[str], object]) -> None:
        self._lines, self.say = lines, say
        self.questions = 0
        self._over = False  # the input has ended
        self.real = True

    def ask(self, question: str, parse: Callable[[str], T], default: str = "") -> T:
        """Return a parsed answer; asks again where ``parse`` raises `ValueError`."""
        self.questions += 1
        for _ in range(TRIES):
            self.say(f"{question}{f' [{default}]' if default else ''}")
            answer = self._line() or default
            try:
                return parse(answer)
            except ValueError as error:
                self.say(f"{error}")
        raise HilcellError(f"{question} has no valid answer after {TRIES} tries", code="HC-C40")

    def choose(self, question: str, choices: Mapping[str, str], default: str = "") -> str:
        """Return one of the choices, by its number or its name; ``choices`` have their texts."""
        names = list(choices)
        for number, name in enumerate(names, start=1):
            self.say(f"  {number}  {name}: {choices[name]}")

        def parse(answer: str) -> str:
            if answer in choices:
                return answer
            if answer.isdecimal() and 1 <= int(answer) <= len(names):
                return names[int(answer) - 1]
            raise ValueError(f"expected 1 to {len(names)}, or a name, got {answer!r}")

        return self.ask(question, parse, default or (names[0] if len(names) == 1 else ""))

    def agree(self, question: str) -> bool:
        """Return whether the person agrees; real devices need a whole "yes", typed after it."""
        self.questions += 1
        self.say(f"{question} ({self.how}; another answer moves nothing)")
        self.drop_typed_ahead()
        return self.agrees(self._line())

    @property
    def how(self) -> str:
        """Return how a person agrees."""
        return 'type "yes" to continue' if self.real else "Enter or y continues"

    def agrees(self, line: str) -> bool:
        return line.strip().lower() in (("yes",) if self.real else ("", "y", "yes"))

    def drop_typed_ahead(self) -> None:
        """Forget what was typed before a question of which real devices move."""
        while self.real and not self._over:
            try:
                self._over = self._lines.get_nowait() is None
            except Empty:
                return

    def waiting_line(self, limit_s: float) -> str | None:
        """Return a typed line, None if none comes in time or input has ended."""
        if self._over:
            return None
        try:
            line = self._lines.get(timeout=limit_s)
        except Empty:
            return None
        self._over = line is None
        return line

    def _line(self) -> str:
        line = None if self._over else self._lines.get()
        if line is None:
            self._over = True
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
            raise ValueError(f"expected a number in {unit}, got {answer!r}") from None
        if not low <= value <= high:
            raise ValueError(f"expected {low:g} .. {high:g} {unit}, got {value:g}")
        return value

    return parse


def word(what: str) -> Callable[[str], str]:
    """Return a parser of a text that is not empty."""

    def parse(answer: str) -> str:
        if not answer:
            raise ValueError(f"expected {what}")
        return answer

    return parse
