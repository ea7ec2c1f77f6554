"""Every way that a KRL program may take: which states may reach its statements.

A state is what a statement leaves to those after it, such as where the slide stands. The program is
followed through branches, loops, jumps and its own subprograms; conditions are not judged, so that
a way may be found that is never taken. Subprograms of interrupts and triggers may run after any
statement.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from itertools import chain
from typing import Generic, NamedTuple, TypeVar

from drivers.kuka.program_krl.tokens import KrlError, Statement

DEEPEST = 50  # calls of subprograms within one another: controllers have at most 20
State = TypeVar("State", bound=Hashable)

ENDS = {
    "ENDIF": "IF", "ENDSWITCH": "SWITCH", "ENDFOR": "FOR", "ENDWHILE": "WHILE", "ENDLOOP": "LOOP",
    "UNTIL": "REPEAT",
}  # fmt: skip
PARTS = {"ELSE": "IF", "CASE": "SWITCH", "DEFAULT": "SWITCH"}
LOOPS = ("FOR", "WHILE", "LOOP", "REPEAT")
LEAVES = ("RETURN", "RESUME", "END", "ENDFCT")


class _Open(NamedTuple):
    """A branch or loop that has begun: its word, its place, its parts, and jumps to its end."""

    word: str
    at: int
    parts: list[int]
    exits: list[int]


class Flow(Generic[State]):
    """Follows states through a program's statements by ``step``, which acts on each of them.

    Of states with one ``key`` the first stands for all: where each branch gave a state of its own,
    the ways through 600 branches would be 600 times as many.
    """

    def __init__(
        self,
        blocks: Mapping[str, Sequence[Statement]],
        step: Callable[[Statement, State], Iterable[State]],
        key: Callable[[State], Hashable] = lambda state: state,
    ) -> None:
        self._blocks, self._step, self._key = blocks, step, key
        self._next = {name: _successors(block) for name, block in blocks.items()}
        self._done: dict[tuple[str, Hashable], list[State]] = {}
        self._depth = 0
        found = [each for block in blocks.values() for each in block]
        self._any_time = dict.fromkeys(
            name for each in found if each.is_at_any_time for name in self._called(each)
        )
        called = {name for each in found for name in self._called(each)}
        self._entries = [name for n, name in enumerate(blocks) if n == 0 or name not in called]

    def follow(self, begin: State) -> None:
        """Follow the first program, and each that no way from others leads to, from ``begin``.

        Raises `KrlError` where subprograms call one another too deeply.
        """
        for name in (*self._entries, *self._blocks):
            if not any(entered == name for entered, _ in self._done):
                self._through(name, begin)

    def _through(self, name: str, begin: State) -> list[State]:
        """Return the states at the end of a program that begins in one."""
        begun = name, self._key(begin)
        if begun in self._done:
            return self._done[begun]
        self._done[begun] = [begin]  # as it calls itself
        self._depth += 1
        if self._depth > DEEPEST:
            raise KrlError(f"{name} is called within more than {DEEPEST} others; call it directly")
        block, following, ends = self._blocks[name], self._next[name], list[State]()
        seen, todo = set[tuple[int, Hashable]](), [(0, begin)]
        while todo:
            at, state = todo.pop()
            if (at, self._key(state)) in seen:
                continue
            seen.add((at, self._key(state)))
            if at >= len(block):
                ends.append(state)
                continue
            left = self._after(block[at], state)
            if name not in self._any_time:
                at_any_time = [self._through(each, s) for each in self._any_time for s in left]
                left = self._distinct([*left, *chain.from_iterable(at_any_time)])
            todo += [(after, each) for after in following[at] for each in left]
        self._done[begun] = ends
        self._depth -= 1
        return ends

    def _after(self, statement: Statement, state: State) -> list[State]:
        if statement.is_at_any_time:
            return [state]
        left = self._distinct(self._step(statement, state))
        for name in self._called(statement):
            left = self._distinct(end for each in left for end in self._through(name, each))
        return left

    def _distinct(self, states: Iterable[State]) -> list[State]:
        found: dict[Hashable, State] = {}
        for each in states:
            found.setdefault(self._key(each), each)
        return list(found.values())

    def _called(self, statement: Statement) -> list[str]:
        """Return the own subprograms that a statement calls."""
        pairs = zip(statement.tokens, statement.tokens[1:], strict=False)
        return [one.word for one, other in pairs if other.text == "(" and one.word in self._blocks]


def _successors(block: Sequence[Statement]) -> list[list[int]]:
    """Return for each statement the places of those that may follow; the block's end is one."""
    following = [[n + 1] for n in range(len(block))]
    labels = {each.head: n for n, each in enumerate(block) if each.is_label}
    opened: list[_Open] = []
    for n, each in enumerate(block):
        if each.head in (*LOOPS, "IF", "SWITCH"):
            opened.append(_Open(each.head, n, [], []))
        elif each.head in PARTS and opened and opened[-1].word == PARTS[each.head]:
            opened[-1].parts.append(n)
        elif each.head in ENDS and opened and opened[-1].word == ENDS[each.head]:
            _close(opened.pop(), n, block, following)
        elif each.head == "EXIT":
            loops = [one for one in opened if one.word in LOOPS]
            following[n] = []
            (loops[-1].exits if loops else []).append(n)
        elif each.head == "GOTO":
            label = each.tokens[1].word if len(each.tokens) > 1 else ""
            following[n] = [labels.get(label, len(block))]
        elif each.head in LEAVES:
            following[n] = [len(block)]
    return following


def _close(begun: _Open, end: int, block: Sequence[Statement], following: list[list[int]]) -> None:
    """Lead the ways of a branch or loop that ends at ``end`` to where they go on."""
    at, parts = begun.at, begun.parts
    if begun.word in LOOPS:
        following[end] = [at] if begun.word != "REPEAT" else [at, end + 1]
        if begun.word in ("FOR", "WHILE"):
            following[at].append(end + 1)
        for each in begun.exits:
            following[each] = [end + 1]
        return
    for each in parts:
        following[each] = [end]
    first = [] if begun.word == "SWITCH" else [at + 1]
    whole = any(block[each].head in ("ELSE", "DEFAULT") for each in parts)
    following[at] = [*first, *(each + 1 for each in parts), *([] if whole else [end])]
