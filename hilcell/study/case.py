"""One case of a study: a calibration in a worker's process, which reads no file; its figures."""

from __future__ import annotations

import os
import platform
import tempfile
from collections.abc import Callable, Mapping
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import TypeAlias

import msgspec
import numpy as np

from hilcell import __version__
from hilcell.calibration.frames import world_from_tracker
from hilcell.calibration.position_errors import targets
from hilcell.cell.devices import in_process_cell, load_entry
from hilcell.cell.file import Cell
from hilcell.cell.settings import SettingsError, convert
from hilcell.decoding import decoded, typed
from hilcell.errors import HilcellError
from hilcell.geometry.frames import apply
from hilcell.geometry.statistics import figures_of, lengths_mm
from hilcell.journal.log import Log
from hilcell.model.point import Sent
from hilcell.model.results import Calibrated, Place, TargetBounds
from hilcell.model.verdicts import OTHERS
from hilcell.ports import Array, InProcessCell
from hilcell.run.procedure import Plan, Procedure, run_in_process

IDW = "idw_mm"
Level: TypeAlias = float | str | None  # of a factor, in a table
STATES = DONE, CANNOT_BE, FAILED = "done", "cannot be", "failed"


class CaseResult(msgspec.Struct, frozen=True):
    """A worker's result; ``minutes`` are the robot's. ``versions``: the worker's, if they differ
    from the study's; then the case was not simulated.
    """

    state: str
    reason: str = ""
    minutes: float | None = None
    figures: Mapping[str, float] = {}
    versions: Mapping[str, str] = {}


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """A stored case: levels by factor, figures by the names of `RESULTS`.

    ``minutes`` of robot and people, and figures, are missing without a result.
    """

    case: int
    point: int
    machine: int
    seed: int
    levels: dict[str, Level]
    state: str
    reason: str
    minutes: float | None
    cost: float
    figures: dict[str, float | None]

    def figure(self, name: str) -> float:
        """Return a figure, or the minutes; raises `LookupError` for a case without it."""
        figure = self.minutes if name == "minutes" else self.figures[name]
        if figure is None:
            raise LookupError(f"case {self.case} has no {name}")
        return figure


def encode_cell(cell: Cell) -> bytes:
    """Return a cell as bytes for a worker."""
    return msgspec.json.encode(cell)


def decode_cell(content: bytes) -> Cell:
    def without_nulls(value: object) -> object:  # a missing value is null in JSON
        if isinstance(value, dict):
            return {key: without_nulls(each) for key, each in value.items() if each is not None}
        return [without_nulls(each) for each in value] if isinstance(value, list) else value

    values = typed(without_nulls(decoded(content, dict[str, object])), dict[str, object])
    return convert(values, Cell, "cell")


def calibrate_case(cell: bytes, machine: int, seed: int, expected: Mapping[str, str]) -> CaseResult:
    """Calibrate a simulated cell without wires.

    ``expected`` are the versions of the study. Without a plan, or if the run ends early, the result
    has a reason.
    """
    here = versions()
    if here != dict(expected):
        return CaseResult(FAILED, versions=here)
    calibrate: Procedure = load_entry("procedures", "calibrate")
    try:
        simulated, plan = planned(cell, seed)
    except HilcellError as error:
        return CaseResult(CANNOT_BE, str(error))
    with tempfile.TemporaryDirectory(prefix="hilcell-study-") as folder:
        try:
            made = in_process_cell(simulated, machine, seed)
            log = run_in_process(
                simulated,
                calibrate,
                seed=seed,
                machine_seed=machine,
                folder=Path(folder),
                plan=plan,
                simulated=made,
            )
            result = typed(calibrate.result(log), Calibrated)
            found = figures(result, true_errors_mm(log, made))
            return CaseResult(DONE, "", plan.duration_s / 60.0, found)
        except SettingsError as error:  # an impossible machine
            return CaseResult(CANNOT_BE, str(error))
        except HilcellError as error:
            return CaseResult(FAILED, str(error))
        except Exception as error:  # noqa: BLE001 - a defect affects this case only
            return CaseResult(
                FAILED, f"a defect, please report it: {type(error).__name__}: {error}"
            )


@lru_cache(64)  # of some 0.1 MiB; machines of one design share them
def planned(content: bytes, seed: int) -> tuple[Cell, Plan]:
    """Return a cell and its plan for the targets of a seed; raises `HilcellError`."""
    cell, calibrate = decode_cell(content), load_entry("procedures", "calibrate")
    return cell, calibrate.plan(cell, seed)


def versions() -> dict[str, str]:
    """Return the versions on which the digits of a result depend."""
    return {
        "hilcell": __version__,
        "python": ".".join(platform.python_version_tuple()[:2]),
        "numpy": version("numpy"),
        "scipy": version("scipy"),
        "threads of BLAS": os.environ.get("OMP_NUM_THREADS", "not limited"),
    }


def true_errors_mm(log: Log, simulated: InProcessCell) -> Array:
    """Return the true 3D errors (N,) of all corrected targets at all stations, in mm.

    Actual is where the machine put the tool at the very readings that count in the validation, with
    its repeatability and warmth at that moment, without the tracker's errors. A part stands in the
    hall: its frame is the {W} that the first three floor nests span where they really are. So the
    errors of the {W} and of the base frames that the run measured are errors of the tool.
    """
    points = [p for station in log.cell.station for p in targets(log, station.name, Sent.CHOSEN)]
    taken_s = [point.readings.tracker.taken_s for point in points if point.readings is not None]
    places_mm, nests_mm = simulated.true_places(taken_s)
    nominal_mm = np.array([point.nominal_mm for point in points])
    return lengths_mm(apply(world_from_tracker(log.cell, nests_mm), places_mm) - nominal_mm)


class _Validated:
    """The validation of a run: at the grid's station, and at all others together.

    ``true_mm`` (N,) are the true errors of all targets.
    """

    def __init__(self, result: Calibrated, true_mm: Array) -> None:
        self.result, self.true = result, figures_of(true_mm)
        first, *_ = result.validation.values()
        others = (place for name, place in result.validation.items() if name == OTHERS)
        self.places = [first, *others]
        self.targets = float(sum(place.points for place in self.places))

    def mean(self, of: Callable[[Place], float]) -> float:
        return sum(place.points * of(place) for place in self.places) / self.targets

    def by_idw(self) -> float | None:
        """Return the mean error by the paper's method; None for a quick plan, which omits it."""
        sent = [(place.points, place.idw) for place in self.places]
        means = [points * errors.mean for points, errors in sent if errors is not None]
        return sum(means) / self.targets if len(means) == len(sent) else None


def _bounds(place: Place) -> TargetBounds:
    if place.bounds is None:
        raise LookupError("the run allows no bounds")
    return place.bounds


RESULTS: Mapping[str, tuple[str, Callable[[_Validated], float | None]]] = {
    "mean_mm": ("mean error after correction", lambda r: r.mean(lambda p: p.chosen.mean)),
    "p95_mm": (
        "95 % quantile of the error, of the worse place",
        lambda r: max(place.chosen.p95 for place in r.places),
    ),
    "max_mm": ("largest error", lambda r: max(place.chosen.max for place in r.places)),
    "true_mean_mm": ("true mean error after correction", lambda r: r.true.mean),
    "true_p95_mm": ("95 % quantile of the true error", lambda r: r.true.p95),
    "true_max_mm": ("largest true error", lambda r: r.true.max),
    "grid_mm": ("mean error at the grid's station", lambda r: r.places[0].chosen.mean),
    "others_mm": ("mean error at the other stations", lambda r: r.places[-1].chosen.mean),
    "before_mm": ("mean error before correction", lambda r: r.mean(lambda p: p.before.mean)),
    IDW: ("mean error corrected as in the paper (IDW)", _Validated.by_idw),
    "bound95_mm": ("mean 95 % bound of a target", lambda r: r.mean(lambda p: _bounds(p).mean_mm)),
    "covered": (
        "share of targets within their bound",
        lambda r: r.mean(lambda p: _bounds(p).coverage),
    ),
    "floor_mm": (
        "error floor of repeatability and tracker",
        lambda r: r.result.repeatability.floor_mm,
    ),
    "rp_mm": ("repeatability RP as measured", lambda r: r.result.repeatability.rp_mm),
    "frame_u_mm": (
        "uncertainty of the worst station frame at the tool",
        lambda r: max(each.tool_uncertainty_mm for each in r.result.stations.values()),
    ),
    "targets": ("targets validated", lambda r: r.targets),
    "points": ("points measured", lambda r: float(sum(r.result.points.values()))),
    "suspicions": ("suspected causes", lambda r: float(len(r.result.suspicions))),
}


def figures(result: Calibrated, true_mm: Array) -> dict[str, float]:
    run = _Validated(result, true_mm)
    values = {name: value(run) for name, (_, value) in RESULTS.items()}
    return {name: value for name, value in values.items() if value is not None}
