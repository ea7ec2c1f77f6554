"""A calibration as the PTB's Digital Calibration Certificate (DCC): the facts of the report as XML.

Nothing is computed here: every figure comes from the functions that the report calls. Facts that
hilcell cannot know are "not stated"; a simulated run is said to be one, traces to nothing and
conforms to nothing. Names and order, by the PTB's schema, are in ``dcc.xml.j2``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple
from xml.etree.ElementTree import fromstring, indent, register_namespace, tostring

from hilcell import __version__
from hilcell.atomic_files import NotWritten
from hilcell.calibration.decision_rule import guard_band
from hilcell.identity import Identity
from hilcell.model.outcome import Outcome
from hilcell.model.point import Sent
from hilcell.present.renderers import environment
from hilcell.report.budgets import target_budget
from hilcell.report.facts import Facts
from hilcell.report.first_page import Certificate, FirstPage, Judgement, Result
from hilcell.report.tables import Tables, Validated

# The PTB's schema DCC 3.1.2 gives names and order (namespace ``dcc``), D-SI 2 the quantities
# (``si``): a value has its unit, and a measured one U, k and the coverage probability. Lengths
# are in ``\milli\metre``: digit for digit those of the printed report.

MM, DEGREE, CELSIUS = "\\milli\\metre", "\\degree", "\\degreecelsius"
HECTOPASCAL, PERCENT, ONE = "\\hecto\\pascal", "\\percent", "\\one"
FORMS = {MM: ".4f", DEGREE: ".5f", CELSIUS: ".2f", HECTOPASCAL: ".1f", PERCENT: ".1f", ONE: ".0f"}
NOT_SHOWN = "noPass"
CONFORMITY: dict[Judgement, str] = {
    Outcome.ACCEPTED: "pass",
    Outcome.UNDECIDED: NOT_SHOWN,
    "suspected": NOT_SHOWN,
    Outcome.REJECTED: "fail",
}


class Quantity(NamedTuple):
    """A figure as text in its unit, U (k = 2) where it has one; programs find it by ``ref``."""

    name: str
    value: str
    unit: str
    ref: str
    U: str
    limit: Limit | None


class Limit(NamedTuple):
    """The limit of a figure, and whether the figure keeps it."""

    words: str
    conformity: str
    figure: Quantity


class Series(NamedTuple):
    """A list of figures; of targets sent in one way, ``status`` is before or after adjustment."""

    name: str
    figures: list[Quantity]
    ref: str = ""
    status: str = ""
    how: str = ""


class Statement(NamedTuple):
    """A statement of the certificate."""

    words: str
    norm: str = ""
    traceable: str = ""
    valid: str = ""
    conformity: str = ""


def quantity(
    name: str, value: float, unit: str, ref: str, U: float | None = None, limit: Limit | None = None
) -> Quantity:
    """Return a figure in the form of its unit; raises `ValueError` for one that is not finite."""
    if not math.isfinite(value):
        raise ValueError(f"a certificate states no {value} {unit}")
    form = FORMS[unit]
    return Quantity(
        name, format(value, form), unit, ref, "" if U is None else format(U, form), limit
    )


def dcc_bytes(facts: Facts) -> bytes:
    """Return the certificate; raises `NotWritten` where the run has judged no correction."""
    page, content = FirstPage(facts), _Certificate(facts)
    if facts.log.calibration != "validated" or not page.station_verdicts():
        raise NotWritten(
            f"run {facts.run}: no certificate, its calibration is "
            f"{facts.log.calibration.replace('_', ' ')}; expected one whose targets were measured "
            "and judged; `hilcell report` shows what there is"
        )
    written = environment("hilcell.report").get_template("dcc.xml.j2").render(
        facts=facts,
        cell=facts.cell,
        parties=facts.cell.certificate,
        schema="3.1.2",
        version=__version__,
        release=content.release,
        robot=facts.asset("robot") or Identity(),
        statements=content.statements(),
        title=Certificate(facts).title(),
        method=Certificate(facts).method(),
        instruments=page.instrument_rows(),
        air=[*content.air()],
        conditions=Certificate(facts).conditions(),
        results=[
            ("3-D position error of the tool point", "hilcell_error", [*content.errors()]),
            ("Orientation error of the tool", "hilcell_turn", [*content.turns()]),
            ("95 % bounds of corrected targets", "hilcell_bound", [*content.bounds()]),
            ("Frames in {W}", "hilcell_frame", [*content.frames()]),
        ],
    )  # fmt: skip
    root = fromstring(written)  # noqa: S314 - of the template, every value escaped
    register_namespace("dcc", "https://ptb.de/dcc")
    register_namespace("si", "https://ptb.de/si")
    indent(root)
    return bytes(tostring(root, encoding="utf-8", xml_declaration=True)) + b"\n"


@dataclass(frozen=True, eq=False)
class _Certificate:
    facts: Facts

    @staticmethod
    def release(version: str) -> str:
        return f"v{version}" if re.fullmatch(r"\d{1,3}(\.\d{1,3}){0,3}", version) else version

    def statements(self) -> Iterator[Statement]:
        page = FirstPage(self.facts)
        if self.facts.inputs.simulated:
            yield Statement("Simulation. No machine moved and no instrument measured: every "
                            "figure comes from a simulated cell, traces to nothing and "
                            "calibrates nothing.",
                            traceable="false", valid="false")  # fmt: skip
        else:
            yield Statement(page.traceability(), traceable="true" if page.certified() else "false")
        if self.facts.revoked:
            yield Statement(f"Revoked: {self.facts.revoked}", valid="false")
        if valid := "; ".join(f"{each.name}: {each.words}" for each in page.validity_facts()):
            yield Statement(f"Valid for: {valid}.")
        judged = page.judgement()
        only_would_be = self.facts.inputs.simulated and isinstance(judged, Outcome)
        yield Statement(f"Decision rule: {Certificate(self.facts).conformity()}.", "ISO 14253-1",
                        conformity="" if only_would_be else CONFORMITY.get(judged, ""))  # fmt: skip
        yield Statement(f"Before and after adjustment: {Certificate(self.facts).adjustment()}.")
        yield Statement("The results relate only to the item described and to its state when it "
                        "was measured. No accreditation is claimed by the software.")  # fmt: skip

    def air(self) -> Iterator[tuple[str, str, list[Quantity]]]:
        air = {
            "air temperature": ("basic_temperature", CELSIUS),
            "air pressure": ("basic_pressure", HECTOPASCAL),
            "relative humidity": ("basic_humidityRelative", PERCENT),
        }
        for name, (_, values) in Tables(self.facts).air().items():
            ref, unit = air[name]
            ends = (("Min", "smallest", values.min()), ("Max", "largest", values.max()))
            figures = [
                quantity(f"{words} at the tracker", float(value), unit, ref + end)
                for end, words, value in ends
            ]
            yield name, ref, figures

    def errors(self) -> Iterator[Series]:
        page = FirstPage(self.facts)
        for row in Tables(self.facts).validated_rows():
            judged = row.way == Sent.CHOSEN and row.place in page.station_verdicts()
            limits = [self._limit(each) for each in page.results_at(row.place)] if judged else []
            yield _series(row.place, row.way, row.how, self._figures(row, *limits))

    def _figures(
        self, row: Validated, mean: Limit | None = None, largest: Limit | None = None
    ) -> list[Quantity]:
        """Return the figures of one series, with the limits of its mean and its largest.

        |e| of a target changes by no more than its position, so U of the largest is that of the
        95 % quantile, too.
        """
        figures, guard = row.errors.figures, guard_band(self.facts.log, row.errors.error_mm)
        return [
            quantity("targets", len(row.errors), ONE, "hilcell_targets"),
            quantity("mean", figures.mean, MM, "hilcell_mean", guard.mean_mm, mean),
            quantity("95 % below", figures.p95, MM, "hilcell_p95", guard.max_mm),
            quantity("largest", figures.max, MM, "hilcell_largest", guard.max_mm, largest),
        ]

    def turns(self) -> Iterator[Series]:
        """Yield the angle from the nominal orientation by series, where it was measured."""
        for place, way, turned in Tables(self.facts).oriented():
            angles = turned.figures
            figures = [
                quantity("targets", len(turned), ONE, "hilcell_targets"),
                quantity("mean", angles.mean_deg, DEGREE, "hilcell_mean"),
                quantity("95 % below", angles.p95_deg, DEGREE, "hilcell_p95"),
                quantity("largest", angles.max_deg, DEGREE, "hilcell_largest"),
            ]
            yield _series(place, way, self.facts.series_name(way), figures)

    def bounds(self) -> Iterator[Series]:
        """Yield the 95 % bounds of any target in use, and how many targets kept theirs."""
        for place in target_budget(self.facts.log, self.facts.run).rows():
            figures = (
                ("bound in use, mean", place.use_mean_mm, MM, "hilcell_boundMean"),
                ("bound in use, largest", place.use_max_mm, MM, "hilcell_boundLargest"),
                ("targets within their own bound", place.inside_percent, PERCENT, "hilcell_inside"),
            )
            yield Series(place.name, [
                quantity(name, value, unit, ref)
                for name, value, unit, ref in figures if value is not None
            ])  # fmt: skip

    def frames(self) -> Iterator[Series]:
        for frame in Tables(self.facts).posed():
            values = zip("xyzABC", frame.zyx.tolist(), (MM,) * 3 + (DEGREE,) * 3, strict=True)
            yield Series(
                frame.name,
                [quantity(name, at, unit, f"hilcell_{name}") for name, at, unit in values],
            )

    def _limit(self, result: Result) -> Limit:
        """Return a figure's limit, and whether it is kept; a simulated one only would be."""
        outcome = result.outcome or Outcome.UNDECIDED  # of a bound, which is not judged
        words = f"limit {result.limit:g} mm: {outcome.short}"
        figure = quantity("limit", result.limit, MM, "hilcell_limit")
        if not self.facts.inputs.simulated:
            return Limit(words, CONFORMITY[outcome], figure)
        return Limit(f"{words}, if it were real", "", figure)


def _series(place: str, way: Sent, words: str, figures: list[Quantity]) -> Series:
    status = "beforeAdjustment" if way == Sent.BEFORE else "afterAdjustment"
    return Series(f"{place}, {words}", figures, f"hilcell_{way}", status, words)
