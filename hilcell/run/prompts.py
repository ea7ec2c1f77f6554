"""One prompt to the operator at a time, and the measurement that verifies the answer.

An answer counts only when a measurement that began after it shows the reflector at the requested
place: earlier measurements verify nothing. The worker measures, answers come from any thread.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NamedTuple

import msgspec
import numpy as np

from hilcell.alarms.catalogue import entry_of
from hilcell.cell.file import Cell
from hilcell.errors import DeviceError, NoReading
from hilcell.language import marked
from hilcell.ports import Array, Clock
from hilcell.run.control import RELEASE, Choice, PromptStatus

TEXTS = marked(  # of prompts, which the screen shows in its language
    {
        "flange": "Seat the reflector on the flange",
        "nest": "Seat the reflector in {place}",
        "swap": "Seat the reflector of {reflector} in {place}",
        "aim": "Put the beam on {place}",
        "aim text": "The run goes on by itself once the tracker measures the reflector there. "
        "Nothing moves.",
        "cable": "Plug the rail's cable in again",
        "cable text": "Keep away from the slide until it stands still, and leave the cable out for "
        "3 s at least. The run goes on by itself once the drive answers.",
        "reading": "No good reading of {place}",
    }
)
POLL_S = 0.5
WIDER_MM = 300.0


class Prompt(msgspec.Struct, frozen=True, kw_only=True):
    """The reflector must be within ``limit_mm`` of ``expected_mm``, tracker's frame; None for the
    strip. ``by_itself``: no answer is needed once the verification passes. ``choices`` are other
    answers than "done"; after `RELEASE` the tracker is left alone until the next answer.
    ``unproven``: nobody has shown that the cell file fits the hall, so no run waits unattended.
    """

    title: str
    text: str
    place: str
    expected_mm: tuple[float, float, float] | None
    limit_mm: float
    reason: str
    by_itself: bool = False
    choices: tuple[Choice, ...] = ()
    unproven: bool = False

    @classmethod
    def placement(
        cls, cell: Cell, place: str, at: str, expected_mm: Array, limit_mm: float
    ) -> Prompt:
        """Return the prompt to carry the reflector from ``at`` to ``place``."""
        take = f"Take the reflector from {_where(cell, at)} and" if at else "Take the reflector and"
        title = TEXTS["flange" if place == FLANGE else "nest"]
        return cls(
            title=title.format(place=place),
            text=f"{take} seat it in {_where(cell, place)}. The robot rests at its safe pose"
            f"{', the slide is held' if cell.has_rail else ''}.",
            place=place,
            expected_mm=_rounded(expected_mm),
            limit_mm=limit_mm,
            reason=f"{place} is to be measured, the reflector is {at or 'nowhere'}",
        )

    @classmethod
    def swap(cls, cell: Cell, place: str, nest: str, expected_mm: Array) -> Prompt:
        """Return the prompt to place the reflector of ``place`` in a floor nest; to return all
        reflectors if it is the nest's own.
        """
        into = _where(cell, nest)
        text = f"Take out the reflector of {into}, and seat in it that of {_where(cell, place)}."
        if place == nest:
            text = f"Put every reflector back where it belongs, its own into {into}."
        return cls(
            title=TEXTS["swap"].format(reflector=place, place=nest),
            text=f"{text} Clean nest and ball. The robot rests at its safe pose.",
            place=nest,
            expected_mm=_rounded(expected_mm),
            limit_mm=20.0,  # a ball of another size has its centre elsewhere in the same nest
            reason=f"the reflector of {place} is to be measured in {nest}",
        )

    @classmethod
    def aim(cls, place: str) -> Prompt:
        """Return the prompt to put the beam on a place; it goes on by itself."""
        return cls(
            title=TEXTS["aim"].format(place=place),
            text=TEXTS["aim text"],
            place=place,
            expected_mm=None,
            limit_mm=1.0,
            reason=f"{place} is to be found",
            by_itself=True,
        )

    @classmethod
    def plug_in(cls) -> Prompt:
        """Return the prompt to plug a rail's cable in again; it goes on by itself."""
        return cls(
            title=TEXTS["cable"],
            text=TEXTS["cable text"],
            place="rail",
            expected_mm=None,
            limit_mm=1.0,
            reason="the link to the rail is lost",
            by_itself=True,
        )

    @classmethod
    def failed_reading(
        cls,
        cell: Cell,
        key: str,
        place: str,
        near_mm: Array,
        limit_mm: float,
        error: NoReading,
        *,
        choices: tuple[Choice, ...] = (),
        unproven: bool = False,
    ) -> Prompt:
        """Return the prompt after failed readings of a reflector.

        The driver's message is in the alarm and the journal.
        """
        entry = entry_of(error.code, error.device)
        found = entry.title if entry.specific else error.found
        advice = _advice(error)
        text = f"{found}, at {_where(cell, place)}. {advice[:1].upper()}{advice[1:]}."
        if looked := where_looked(near_mm, error):
            text += f" Expected {looked}."
        return cls(
            title=TEXTS["reading"].format(place=place),
            text=text,
            place=place,
            expected_mm=_rounded(near_mm),
            limit_mm=limit_mm,
            reason=f"{key}: {error.summary}",
            choices=choices,
            unproven=unproven,
        )

    def passed_by(self, result: Verification) -> bool:
        """Whether the reflector is at the requested place, or at the one that was chosen; NaN never
        passes.
        """
        limit_mm = np.inf if result.choice else self.limit_mm
        return result.seen_mm is not None and result.seen_mm <= limit_mm

    def refusal(self, result: Verification, lost: Mapping[str, DeviceError]) -> str:
        """Return the refusal of an answer; ``lost`` are the devices that do not answer, by name."""
        if lost:
            found = "; ".join(f"{name} is lost: {error.summary}" for name, error in lost.items())
            return f"{found}; repair that; if it stays lost, stop the run and resume it"
        if result.choice:
            return result.reason
        if self.by_itself or self.expected_mm is None:
            return f"{self.place}: {result.reason}"
        if result.seen_mm is None:
            return f"the tracker sees no reflector at {self.place}: {result.reason}"
        return (
            f"the tracker sees a reflector {result.seen_mm:.2f} mm from {self.place}, "
            f"expected <= {self.limit_mm:.1f} mm"
        )

    def unanswered(self, cause: NoReading | None) -> DeviceError:
        """Return the fault of a run that prompts without an operator."""
        if cause is None:
            return DeviceError("HC-C16", "Tracker", "measure", self.reason)
        return DeviceError(
            cause.code,
            cause.device,
            cause.operation,
            cause.found,
            expected=cause.expected,
            act=UNPROVEN if self.unproven else _advice(cause),
            fields=cause.fields,
        )


@dataclass(frozen=True, slots=True)
class Verification:
    """The distance from the expected place, or the reason why nothing was measured.

    For the strip it is the distance from the drive's position. ``lost``: the device did not answer.
    ``choice``: the answer that was verified, "" for "done".
    """

    seen_mm: float | None
    reason: str
    taken_s: float
    xyz_mm: tuple[float, float, float] | None = None
    lost: bool = False
    choice: str = ""

    @property
    def released(self) -> bool:
        """Whether the beam was let go, and the prompt waits for another answer."""
        return self.choice == RELEASE and not self.reason

    @classmethod
    def failed(cls, error: DeviceError, at_s: float, choice: str = "") -> Verification:
        lost = not isinstance(error, NoReading)
        return cls(None, error.summary, at_s, lost=lost, choice=choice)


class Answer(NamedTuple):
    """An answer that waits: its choice, "" for "done", and what takes its refusal, or ""."""

    choice: str
    refusal: Future[str]


NO_CHOICES: Mapping[str, Callable[[], Verification]] = MappingProxyType({})


class PendingPrompt:
    """The open prompt, its last verification, and the answers that wait for one."""

    def __init__(self, clock: Clock) -> None:
        self._clock, self._lock = clock, threading.Lock()
        self._asked = threading.Event()
        self._prompt: Prompt | None = None
        self._verification: Verification | None = None
        self._answers: list[Answer] = []

    # -- any thread ---------------------------------------------------------------------------

    def answer(self, choice: str = "") -> Future[str]:
        """Report that it is done, or a choice; the future holds the refusal, or ""."""
        future: Future[str] = Future()
        with self._lock:
            known = [] if self._prompt is None else [each.name for each in self._prompt.choices]
            if self._prompt is None:
                future.set_result("nothing is asked now")
            elif choice and choice not in known:
                words = f"one of {', '.join(known)}" if known else "none"
                future.set_result(f"answer: expected {words}, got {choice[:80]!r}")
            else:
                self._answers.append(Answer(choice, future))
                self._asked.set()
        return future

    def status(self) -> PromptStatus | None:
        """Return the prompt with its last verification, or None."""
        with self._lock:
            prompt, result = self._prompt, self._verification
        if prompt is None:
            return None
        age_s = None if result is None else round(max(0.0, self._clock.pc_s() - result.taken_s), 2)
        seen_mm = None if result is None or result.seen_mm is None else round(result.seen_mm, 3)
        return PromptStatus(
            title=prompt.title,
            text=prompt.text,
            place=prompt.place,
            expected_mm=prompt.expected_mm,
            limit_mm=prompt.limit_mm,
            seen_mm=seen_mm,
            age_s=age_s,
            ready=result is not None and prompt.passed_by(result),
            choices=prompt.choices,
        )

    # -- the worker's thread ------------------------------------------------------------------

    def open(self, prompt: Prompt) -> None:
        with self._lock:
            self._prompt, self._verification = prompt, None

    def take_answers(self, limit_s: float) -> list[Answer]:
        """Wait at most ``limit_s`` for answers, and take those that came."""
        self._asked.wait(limit_s)
        with self._lock:
            answers, self._answers = self._answers, []
            self._asked.clear()
        return answers

    def show(self, result: Verification) -> None:
        """Publish a verification; one without an answer keeps the age of the last answered one."""
        with self._lock:
            if result.lost:
                before = self._verification
                self._verification = (
                    None if before is None else replace(result, taken_s=before.taken_s)
                )
            else:
                self._verification = result

    def close(self, reason: str) -> None:
        """Close the prompt; refuse the answers that still wait."""
        with self._lock:
            answers, self._answers = self._answers, []
            self._prompt = self._verification = None
        for answer in answers:
            answer.refusal.set_result(reason)


UNPROVEN = (
    "nobody has shown yet that the cell file fits the hall: start the run attended and take the "
    "place of the nest there, or correct tracker.pose and [[layout.floor]]"
)


def where_looked(near_mm: Array, error: NoReading) -> str:
    """Return where a reflector was expected, and where and how far a tracker has searched for it.

    ``near_mm`` (3,), tracker's frame. "" where the driver does not state it.
    """
    searched_mm, beam = error.fields.get("searched_mm"), error.fields.get("beam")
    if not isinstance(searched_mm, int | float):
        return ""
    text = f"at {_shown(near_mm)}, searched {searched_mm:.0f} mm around"
    if not isinstance(beam, list):
        return text
    looked_mm = float(np.linalg.norm(near_mm)) * np.array(beam, dtype=float)
    beside_mm = float(np.linalg.norm(looked_mm - near_mm))
    return f"{text}; the beam looks at {_shown(looked_mm)}, {beside_mm:.0f} mm beside"


def _shown(at_mm: Array) -> str:
    x, y, z = at_mm
    return f"x {x:.0f}, y {y:.0f}, z {z:.0f} mm of the tracker"


def _advice(error: NoReading) -> str:
    """The first step of the alarm's entry; without an entry the driver's advice, or the usual."""
    entry = entry_of(error.code, error.device)
    if entry.specific:
        return entry.do[0].removesuffix(".")
    usual = "check that nothing is in the line of sight, and that the reflector is clean and seated"
    return error.act or usual


FLANGE = "flange"


def _where(cell: Cell, place: str) -> str:
    layout = cell.layout
    for nests, on in ((layout.floor, "floor"), (layout.bar, "bar"), (layout.slide, "slide")):
        for nest in nests:
            if nest.name == place:
                frame = "nominal {B}" if on == "slide" else "{W}"
                at = f"x {nest.x_mm:.0f}, y {nest.y_mm:.0f}, z {nest.z_mm:.0f} mm in {frame}"
                return f"nest {place} on the {on}, {at}"
    if place == FLANGE:
        return "the nest on the robot's flange"
    seat = place.removeprefix(f"{FLANGE} ")
    return f"reflector {seat} on the robot's flange" if seat != place else f"reflector {place}"


def _rounded(at_mm: Array) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 3) for value in at_mm)
    return x, y, z
