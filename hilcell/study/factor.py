"""A factor of a study: by levels, or in a range with a distribution."""

from __future__ import annotations

import bisect
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from operator import attrgetter
from typing import Annotated, TypeVar

from msgspec import Meta

from hilcell.cell.settings import did_you_mean, is_read, refuse
from hilcell.cell.tables import Frozen, Name
from hilcell.decoding import typed

KINDS: Mapping[str, tuple[str, ...]] = {
    "normal": ("mean", "sd"),
    "lognormal": ("median", "ratio"),
    "loguniform": (),
    "triangular": ("mode",),
}
PARAMETERS = tuple(dict.fromkeys(key for keys in KINDS.values() for key in keys))
T = TypeVar("T")


class Distribution(Frozen, frozen=True, kw_only=True):
    """A ``kind`` and its parameters, cut off at low and high.

    Of a lognormal 68 % lie within ``median`` / ``ratio`` and ``median`` x ``ratio``.
    """

    kind: str
    mean: float | None = None
    sd: Annotated[float, Meta(gt=0)] | None = None
    median: Annotated[float, Meta(gt=0)] | None = None
    ratio: Annotated[float, Meta(gt=1)] | None = None
    mode: float | None = None

    def __post_init__(self) -> None:
        refuse(self._problems())

    @property
    def stated(self) -> Mapping[str, float]:
        return {key: getattr(self, key) for key in PARAMETERS if getattr(self, key) is not None}

    @property
    def words(self) -> str:
        return ", ".join([self.kind, *(f"{key} {each:g}" for key, each in self.stated.items())])

    def problems_between(self, low: float, high: float) -> Iterator[str]:
        from scipy.stats import norm

        if self.kind.startswith("log") and not low > 0.0:
            yield f"distribution: {self.kind} wants a low above 0, found {low:g}"
        elif self.kind == "triangular" and not low <= self.stated["mode"] <= high:
            yield f"distribution.mode: {self.stated['mode']:g} is outside {low:g} .. {high:g}"
        elif self.kind in ("normal", "lognormal"):
            first, last = self._ends(low, high)
            if not norm.cdf(last) - norm.cdf(first) >= 1e-6:
                yield f"distribution: hardly any of it is within {low:g} .. {high:g}"

    def value(self, share: float, low: float, high: float) -> float:
        """Return the value below which a share (0 to 1) of it lies, between low and high."""
        from scipy.stats import loguniform, triang, truncnorm

        stated, width = self.stated, high - low
        match self.kind:
            case "normal":
                sds = truncnorm.ppf(share, *self._ends(low, high))
                found = stated["mean"] + sds * stated["sd"]
            case "lognormal":
                sds = truncnorm.ppf(share, *self._ends(low, high))
                found = stated["median"] * stated["ratio"] ** sds
            case "loguniform":
                found = loguniform.ppf(share, low, high)
            case _:
                found = triang.ppf(share, (stated["mode"] - low) / width, low, width)
        return min(max(float(found), low), high)  # to rounding

    def _ends(self, low: float, high: float) -> tuple[float, float]:
        """Return low and high in standard deviations of the normal distribution beneath."""
        stated = self.stated
        if self.kind == "normal":
            return (low - stated["mean"]) / stated["sd"], (high - stated["mean"]) / stated["sd"]
        width = math.log(stated["ratio"])
        first, last = (math.log(end / stated["median"]) / width for end in (low, high))
        return first, last

    def _problems(self) -> Iterator[str]:
        wanted = KINDS.get(self.kind)
        if wanted is None:
            hint = did_you_mean(self.kind, KINDS) or f"; known: {', '.join(KINDS)}"
            yield f"kind: {self.kind!r} is no distribution{hint}"
            return
        for key in PARAMETERS:
            stated = is_stated(self, attrgetter(key))
            if stated and key not in wanted:
                yield f"{key}: {self.kind} has none"
            elif key in wanted and not stated:
                yield f"{key}: missing; {self.kind} needs it"


Money = Annotated[float, Meta(ge=-1e12, le=1e12)]
UNITS = {
    "_mm_s2": "mm/s²", "_mm_s": "mm/s", "_percent": "%", "_urad": "µrad", "_mm": "mm",
    "_deg": "deg", "_s": "s",
}  # fmt: skip


class Factor(Frozen, frozen=True, kw_only=True):
    """One setting of the cell that varies: by ``levels``, or between ``low`` and ``high``.

    Without a ``setting`` each level is a table of several. The first level, or ``low``, is where
    `buy next` starts. ``weights`` and ``distribution`` say how often a Sobol design draws what.
    ``costs`` (money) and ``minutes`` (of people, besides the robot's) are one for each level, or
    two: at low and at high.
    """

    name: Name
    setting: str = ""
    levels: list[object] | None = None
    labels: list[str] | None = None
    weights: list[Annotated[float, Meta(gt=0, le=1e12)]] | None = None
    low: int | float | None = None
    high: int | float | None = None
    distribution: Distribution | None = None
    costs: list[Money] | None = None
    minutes: list[Money] | None = None

    def __post_init__(self) -> None:
        refuse(line for check in self.checks() for line in check())

    def checks(self) -> Sequence[Callable[[], Iterator[str]]]:
        """Return checks of the whole, each of which needs a few fields only."""
        return [
            self._stated,
            self._range_without_levels,
            self._range_of_one_setting,
            self._range_ascends,
            self._levels_without_range,
            self._levels_apart,
            self._levels_named,
            *(partial(self._one_each, key) for key in ("labels", "weights", "costs", "minutes")),
        ]

    @property
    def is_range(self) -> bool:
        return self.levels is None

    @property
    def is_whole(self) -> bool:
        return self.is_range and all(isinstance(each, int) for each in self.ends)

    @property
    def is_number(self) -> bool:
        """Whether its values are numbers, which a table of results keeps as such."""
        return self.labels is None and all(
            isinstance(each, int | float) and not isinstance(each, bool) for each in self.ends
        )

    @property
    def ends(self) -> Sequence[object]:
        """Return its levels, or low and high."""
        return [self.low, self.high] if self.levels is None else self.levels

    @property
    def span(self) -> tuple[float, float]:
        """Return low and high of a range; raises `ValueError` for a factor of levels."""
        if self.low is None or self.high is None:
            raise ValueError(f"{self.setting}: expected a range, got levels")
        return self.low, self.high

    @property
    def steps(self) -> Sequence[float]:
        """Return the numbers of its levels, the whole numbers of a range, or the ends of another.

        Of such a range there are more.
        """
        if self.is_whole:
            low, high = self.span
            return range(round(low), round(high) + 1)
        return self.span if self.is_range else range(len(self.ends))

    @property
    def names(self) -> list[str]:
        return self.labels or [_word(each) for each in self.ends]

    @property
    def title(self) -> str:
        """Return its name as a heading: with the unit of its numbers, which its setting ends in."""
        unit = next((UNITS[end] for end in UNITS if self.setting.endswith(end)), "")
        wanted = unit and self.is_number and self.name.split()[-1] != unit
        return f"{self.name} {unit}" if wanted else self.name

    @property
    def settings_named(self) -> list[str]:
        if self.setting:
            return [self.setting]
        tables = [each for each in self.levels or () if isinstance(each, Mapping)]
        return list(dict.fromkeys(key for each in tables for key in each))

    def settings(self, value: object) -> Mapping[str, object]:
        return {self.setting: value} if self.setting else typed(value, dict[str, object])

    def drawn(self, share: float) -> float:
        """Return the value of a range below which a share (0 to 1) of all lies."""
        low, high = self.span
        if self.distribution is None:
            value = low + share * (high - low)
        else:
            value = self.distribution.value(share, low, high)
        return round(value) if self.is_whole else float(value)

    def level(self, share: float) -> int:
        """Return the number of the level below which a share (0 to 1) of all levels lies."""
        weights = self.weights or [1.0] * len(self.ends)
        sums = list(itertools.accumulate(weights))
        return min(bisect.bisect_right(sums, share * sums[-1]), len(weights) - 1)

    @property
    def _has_range(self) -> bool:
        ends = is_stated(self, lambda it: it.low) and is_stated(self, lambda it: it.high)
        return ends and self.is_range

    @property
    def _has_levels(self) -> bool:
        return not self.is_range and self.low is None and self.high is None

    def _stated(self) -> Iterator[str]:
        if not (self._has_range or self._has_levels):
            yield "expected levels, or low and high"

    def _range_without_levels(self) -> Iterator[str]:
        for key in ("labels", "weights"):
            if self._has_range and is_stated(self, attrgetter(key)):
                yield f"{key}: these are for levels"

    def _range_of_one_setting(self) -> Iterator[str]:
        if self._has_range and not self.setting:
            yield "setting: missing; which setting has this range?"

    def _range_ascends(self) -> Iterator[str]:
        if not self._has_range:
            return
        low, high = self.span
        if not low < high:
            yield f"low {low:g} must be below high {high:g}"
        elif isinstance(self.distribution, Distribution):  # one that could be read
            yield from self.distribution.problems_between(low, high)

    def _levels_without_range(self) -> Iterator[str]:
        if self._has_levels and is_stated(self, lambda it: it.distribution):
            yield "distribution: this is for low and high; levels have weights"

    def _levels_apart(self) -> Iterator[str]:
        if not self._has_levels:
            return
        if len(self.ends) < 2:
            yield f"levels: expected two or more, got {len(self.ends)}"
        elif len(set(self.names)) < len(self.names):
            yield "levels: two are alike; give each its own, or its own label"

    def _levels_named(self) -> Iterator[str]:
        if not self._has_levels or self.setting:
            return
        if not all(isinstance(each, Mapping) and each for each in self.ends):
            yield "setting: missing; without it each level is a table of settings"
        elif self.labels is None:
            yield "labels: missing; levels that are tables of settings need names"

    def _one_each(self, key: str) -> Iterator[str]:
        """Yield that a list has not one for each level, or each end."""
        given = getattr(self, key)
        if not (self._has_range or self._has_levels) or given is None:
            return
        if len(given) != len(self.ends):
            yield f"{key}: expected {len(self.ends)}, got {len(given)}"


def is_stated(table: T, field: Callable[[T], object]) -> bool:
    """Whether a field of a table has a value; one that could not be read has one."""
    return not is_read(table, field) or field(table) is not None


def _word(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.12g}" if isinstance(value, float) else str(value)
