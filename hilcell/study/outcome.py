"""The findings of a case: figures of one calibration, computed from its result."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from hilcell.model.point import Sent

Result = Mapping[str, Any]


def _places(result: Result) -> list[Mapping[str, Any]]:
    """Return the validation at the grid's station, and at all others together where there are."""
    validation = result["validation"]
    names = list(validation)
    return [validation[names[0]], *([validation["others"]] if "others" in validation else [])]


def _mean(result: Result, what: str, key: str = "mean") -> float:
    """Return the mean over all targets of all stations."""
    places = _places(result)
    targets = [place["points"] for place in places]
    total = sum(n * place[what][key] for n, place in zip(targets, places, strict=True))
    return float(total / sum(targets))


def _worst(result: Result, key: str) -> float:
    return float(max(place[Sent.CHOSEN][key] for place in _places(result)))


def _stations(result: Result) -> float:
    return float(max(each["tool_uncertainty_mm"] for each in result["stations"].values()))


def _targets(result: Result) -> float:
    return float(sum(place["points"] for place in _places(result)))


RESULTS: Mapping[str, tuple[str, Callable[[Result], float]]] = {
    "mean_mm": ("mean error after correction", lambda r: _mean(r, Sent.CHOSEN)),
    "p95_mm": ("95 % quantile of the error, of the worse place", lambda r: _worst(r, "p95")),
    "max_mm": ("largest error", lambda r: _worst(r, "max")),
    "grid_mm": (
        "mean error at the grid's station",
        lambda r: float(_places(r)[0][Sent.CHOSEN]["mean"]),
    ),
    "others_mm": (
        "mean error at the other stations",
        lambda r: float(_places(r)[-1][Sent.CHOSEN]["mean"]),
    ),
    "before_mm": ("mean error before correction", lambda r: _mean(r, Sent.BEFORE)),
    "idw_mm": ("mean error corrected as in the paper (IDW)", lambda r: _mean(r, Sent.IDW)),
    "bound95_mm": ("mean 95 % bound of a target", lambda r: _mean(r, Sent.CHOSEN, "bound95_mean")),
    "covered": ("share of targets within their bound", lambda r: _mean(r, Sent.CHOSEN, "covered")),
    "floor_mm": (
        "error that repeatability and tracker leave",
        lambda r: float(r["repeatability"]["floor_mm"]),
    ),
    "rp_mm": ("repeatability RP as measured", lambda r: float(r["repeatability"]["rp_mm"])),
    "frame_u_mm": ("uncertainty of the worst station frame at the tool", _stations),
    "targets": ("targets validated", _targets),
    "points": ("points measured", lambda r: float(sum(r["points"].values()))),
    "suspicions": ("causes that the run suspects", lambda r: float(len(r["suspicions"]))),
}
