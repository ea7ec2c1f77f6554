"""The findings of a case: figures of one calibration, computed from its result."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from hilcell.calibration.errors import OTHERS
from hilcell.model.results import Calibrated, Place, TargetBounds


def _places(result: Calibrated) -> list[Place]:
    """Return the validation at the grid's station, and at all others together where there are."""
    first, *_ = result.validation.values()
    return [first, *(place for name, place in result.validation.items() if name == OTHERS)]


def _mean(result: Calibrated, of: Callable[[Place], float]) -> float:
    """Return the mean over all targets of all stations."""
    places = _places(result)
    return sum(place.points * of(place) for place in places) / _targets(result)


def _targets(result: Calibrated) -> float:
    return float(sum(place.points for place in _places(result)))


def _bounds(place: Place) -> TargetBounds:
    if place.bounds is None:
        raise LookupError("the run allows no bounds")
    return place.bounds


def _by_idw(result: Calibrated) -> float | None:
    """Return the mean error by the paper's method; None of a quick plan, which sends none by it."""
    sent = [(place.points, place.idw) for place in _places(result)]
    means = [points * errors.mean for points, errors in sent if errors is not None]
    return sum(means) / _targets(result) if len(means) == len(sent) else None


IDW = "idw_mm"
RESULTS: Mapping[str, tuple[str, Callable[[Calibrated], float | None]]] = {
    "mean_mm": ("mean error after correction", lambda r: _mean(r, lambda p: p.chosen.mean)),
    "p95_mm": (
        "95 % quantile of the error, of the worse place",
        lambda r: max(place.chosen.p95 for place in _places(r)),
    ),
    "max_mm": ("largest error", lambda r: max(place.chosen.max for place in _places(r))),
    "grid_mm": ("mean error at the grid's station", lambda r: _places(r)[0].chosen.mean),
    "others_mm": ("mean error at the other stations", lambda r: _places(r)[-1].chosen.mean),
    "before_mm": ("mean error before correction", lambda r: _mean(r, lambda p: p.before.mean)),
    IDW: ("mean error corrected as in the paper (IDW)", _by_idw),
    "bound95_mm": ("mean 95 % bound of a target", lambda r: _mean(r, lambda p: _bounds(p).mean_mm)),
    "covered": (
        "share of targets within their bound",
        lambda r: _mean(r, lambda p: _bounds(p).coverage),
    ),
    "floor_mm": (
        "error that repeatability and tracker leave",
        lambda r: r.repeatability.floor_mm,
    ),
    "rp_mm": ("repeatability RP as measured", lambda r: r.repeatability.rp_mm),
    "frame_u_mm": (
        "uncertainty of the worst station frame at the tool",
        lambda r: max(each.tool_uncertainty_mm for each in r.stations.values()),
    ),
    "targets": ("targets validated", _targets),
    "points": ("points measured", lambda r: float(sum(r.points.values()))),
    "suspicions": ("causes that the run suspects", lambda r: float(len(r.suspicions))),
}


def figures(result: Calibrated) -> dict[str, float]:
    """Return the figures that a run has, by name."""
    found = {name: value(result) for name, (_, value) in RESULTS.items()}
    return {name: value for name, value in found.items() if value is not None}
