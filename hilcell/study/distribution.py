"""How the values of a factor are distributed between its low and its high end."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Annotated

from msgspec import Meta

from hilcell.cell.settings import did_you_mean, refuse
from hilcell.cell.tables import Frozen

KINDS: Mapping[str, tuple[str, ...]] = {
    "normal": ("mean", "sd"),
    "lognormal": ("median", "ratio"),
    "loguniform": (),
    "triangular": ("mode",),
}
PARAMETERS = tuple(dict.fromkeys(key for keys in KINDS.values() for key in keys))
LEAST_SHARE = 1e-6  # of a distribution between low and high


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
        """Return its parameters."""
        return {key: getattr(self, key) for key in PARAMETERS if getattr(self, key) is not None}

    @property
    def words(self) -> str:
        """Return it in words."""
        return ", ".join([self.kind, *(f"{key} {each:g}" for key, each in self.stated.items())])

    def problems_between(self, low: float, high: float) -> Iterator[str]:
        """Yield why nothing can be drawn between two ends."""
        from scipy.stats import norm

        if self.kind.startswith("log") and not low > 0.0:
            yield f"distribution: {self.kind} wants a low above 0, found {low:g}"
        elif self.kind == "triangular" and not low <= self.stated["mode"] <= high:
            yield f"distribution.mode: {self.stated['mode']:g} is outside {low:g} .. {high:g}"
        elif self.kind in ("normal", "lognormal"):
            first, last = self._ends(low, high)
            if not norm.cdf(last) - norm.cdf(first) >= LEAST_SHARE:
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
            yield f"kind: {self.kind!r} is none{hint}"
            return
        for key in PARAMETERS:
            is_stated = getattr(self, key, 0.0) is not None  # one that could not be read is stated
            if is_stated and key not in wanted:
                yield f"{key}: {self.kind} has none"
            elif key in wanted and not is_stated:
                yield f"{key}: missing; {self.kind} wants it"
