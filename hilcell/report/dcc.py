"""A calibration as the PTB's Digital Calibration Certificate (DCC): the facts of the report as XML.

Nothing is computed here: every figure comes from the functions that the report calls. Facts that
hilcell cannot know are "not stated"; a simulated run is said to be one, traces to nothing and
conforms to nothing.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from xml.etree.ElementTree import Element, indent, tostring

import numpy as np

from hilcell import __version__
from hilcell.calibration.decision import guard_of
from hilcell.clean import harmless
from hilcell.model.outcome import Outcome
from hilcell.model.point import Sent
from hilcell.report.budgets import TargetBudget, placed, target_budget
from hilcell.report.certificate import (
    adjustment_words,
    conditions_words,
    conformity_words,
    procedure_words,
    title,
)
from hilcell.report.drawings.figures import series_name
from hilcell.report.facts import Facts
from hilcell.report.first_page import (
    FirstPage,
    Judgement,
    Result,
)
from hilcell.report.tables import Posed, Tables, Validated
from hilcell.writing import NotWritten

# The PTB's schema DCC 3.1.2 gives names and order (namespace ``dcc``), D-SI 2 the quantities
# (``si``): a value has its unit, and a measured one U, k and the coverage probability. Lengths
# are in ``\milli\metre``: digit for digit those of the printed report.

VERSION = "3.1.2"
LANGUAGE = "en"
NOT_STATED = "not stated"
MM, DEGREE, CELSIUS, HECTOPASCAL = (
    "\\milli\\metre",
    "\\degree",
    "\\degreecelsius",
    "\\hecto\\pascal",
)
PERCENT, ONE = "\\percent", "\\one"
FORMS = {MM: ".4f", DEGREE: ".5f", CELSIUS: ".2f", HECTOPASCAL: ".1f", PERCENT: ".1f", ONE: ".0f"}

Part = Element | str | None


def dcc(name: str, *parts: Part, **attributes: str) -> Element:
    """Return an element of the DCC with its text or children; None is left out."""
    return _element(f"dcc:{name}", parts, attributes)


def si(name: str, *parts: Part) -> Element:
    """Return an element of D-SI with its text or children; None is left out."""
    return _element(f"si:{name}", parts, {})


def _element(tag: str, parts: tuple[Part, ...], attributes: dict[str, str]) -> Element:
    found = Element(tag, attributes)
    for part in parts:
        if isinstance(part, str):
            found.text = harmless(part)
        elif part is not None:
            found.append(part)
    return found


def text(name: str, words: str) -> Element:
    """Return a named text in the certificate's language; a required one is never empty."""
    return dcc(name, dcc("content", words or NOT_STATED, lang=LANGUAGE))


def real(value: float, unit: str, U: float | None = None, k: float = 2.0) -> Element:
    """Return a quantity of D-SI, with its expanded uncertainty where one is stated."""
    form = FORMS[unit]
    if not math.isfinite(value):
        raise ValueError(f"a certificate states no {value} {unit}")
    coverage = "0.95"
    expanded = None if U is None else si(
        "expandedUnc", si("uncertainty", format(U, form)), si("coverageFactor", f"{k:g}"),
        si("coverageProbability", coverage), si("distribution", "normal"),
    )  # fmt: skip
    return si("real", si("value", format(value, form)), si("unit", unit), expanded)


def quantity(words: str, value: Element, *more: Part, ref: str = "") -> Element:
    """Return a named quantity; ``ref`` is how programs find it."""
    attributes = {"refType": ref} if ref else {}
    return dcc("quantity", text("name", words), value, *more, **attributes)


def contact(name: str, who: str, email: str, address: str, country: str = "") -> Element:
    """Return a party with all that the schema requires of it."""
    return dcc(
        name, text("name", who), dcc("eMail", email or NOT_STATED),
        dcc("location", dcc("countryCode", country) if country else None, text("further", address)),
    )  # fmt: skip


def identification(issuer: str, value: str, words: str) -> Element:
    """Return a number that an issuer gave, and what it is."""
    return dcc(
        "identification", dcc("issuer", issuer), dcc("value", value or NOT_STATED),
        text("name", words),
    )  # fmt: skip


def document(root: Element) -> bytes:
    """Return the file: UTF-8, the same every time."""
    indent(root)
    written: bytes = tostring(root, encoding="utf-8", xml_declaration=True)
    return written + b"\n"


UNKNOWN_COUNTRY = "ZZ"  # of ISO 3166-1's codes for the user's own use
NOT_SHOWN = "noPass"
CONFORMITY: dict[Judgement, str] = {
    Outcome.ACCEPTED: "pass",
    Outcome.UNDECIDED: NOT_SHOWN,
    "suspected": NOT_SHOWN,
    Outcome.REJECTED: "fail",
}


def dcc_bytes(facts: Facts) -> bytes:
    """Return the certificate; raises `NotWritten` where the run has judged no correction."""
    if facts.log.calibration != "validated" or not FirstPage(facts).judged_places():
        raise NotWritten(
            f"run {facts.run}: no certificate, its calibration is "
            f"{facts.log.calibration.replace('_', ' ')}; wanted one whose targets were measured "
            "and judged; `hilcell report` shows what there is"
        )
    root = {
        "xmlns:dcc": "https://ptb.de/dcc",
        "xmlns:si": "https://ptb.de/si",
        "xmlns:xsi": "http://www.w3.org/2001/XMLSchema-instance",
        "xsi:schemaLocation": f"https://ptb.de/dcc https://ptb.de/dcc/v{VERSION}/dcc.xsd",
        "schemaVersion": VERSION,
    }
    content = _Certificate(facts)
    return document(dcc("digitalCalibrationCertificate", content.administrative(),
                        content.results(), **root))  # fmt: skip


# -- administrative data ---------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Certificate:
    """The content of a certificate."""

    facts: Facts

    @property
    def _page(self) -> FirstPage:
        return FirstPage(self.facts)

    def administrative(self) -> Element:
        parties, operator = self.facts.cell.certificate, self.facts.inputs.operator
        return dcc(
            "administrativeData",
            dcc("dccSoftware", _software("hilcell", __version__)),
            self._core(),
            self._items(),
            dcc("calibrationLaboratory", contact(
                "contact", parties.laboratory, parties.laboratory_email, parties.laboratory_address,
                parties.country)),
            dcc("respPersons", _person(operator, "measured by", "false"),
                _person("", "authorised by", "true")),
            contact("customer", parties.customer, parties.customer_email, parties.customer_address),
            dcc("statements", *self._statements()),
        )  # fmt: skip

    def _core(self) -> Element:
        return dcc(
            "coreData",
            dcc("countryCodeISO3166_1", self.facts.cell.certificate.country or UNKNOWN_COUNTRY),
            dcc("usedLangCodeISO639_1", LANGUAGE),
            dcc("mandatoryLangCodeISO639_1", LANGUAGE),
            dcc("uniqueIdentifier", f"{self.facts.run}-{self.facts.fingerprint[:16]}"),
            dcc("identifications", *self._numbers()),
            dcc("beginPerformanceDate", self.facts.records[0].t[:10]),
            dcc("endPerformanceDate", self.facts.last.t[:10]),
            dcc("performanceLocation", "customer"),
        )

    def _numbers(self) -> Iterator[Element]:
        yield identification("calibrationLaboratory", self.facts.fingerprint,
                             "SHA-256 of the run's journal")  # fmt: skip
        yield identification(
            "calibrationLaboratory", self.facts.inputs.digest, "SHA-256 of the cell"
        )
        if self.facts.file_digest:
            yield identification("calibrationLaboratory", self.facts.file_digest,
                                 "SHA-256 of the calibration file")  # fmt: skip
        if self.facts.inputs.job:
            yield identification("customer", self.facts.inputs.job, "job")

    def _items(self) -> Element:
        cell = self.facts.cell
        found = [asset for asset in self.facts.log.assets if asset.kind == "robot"]
        serial, maker = (found[0].serial, found[0].maker) if found else ("", "")
        model = found[0].model if found else cell.robot.name
        return dcc("items", dcc(
            "item", text("name", f"Robot {cell.robot.name}{' on a rail' if cell.has_rail else ''}"),
            dcc("manufacturer", text("name", maker)), dcc("model", model or cell.robot.name),
            dcc("identifications", identification("manufacturer", serial, "serial number"),
                identification("owner", f"{cell.name}, serial {cell.serial}", "cell")),
        ))  # fmt: skip

    def _statements(self) -> Iterator[Element]:
        if self.facts.inputs.simulated:
            yield _statement("Simulation. No machine moved and no instrument measured: every "
                             "figure comes from a simulated cell, traces to nothing and "
                             "calibrates nothing.",
                             traceable="false", valid="false")  # fmt: skip
        else:
            yield _statement(
                self._page.traceability(), traceable="true" if self._page.certified() else "false"
            )
        if self.facts.revoked:
            yield _statement(f"Revoked: {self.facts.revoked}", valid="false")
        valid = "; ".join(f"{each.name}: {each.words}" for each in self._page.validity_facts())
        if valid:
            yield _statement(f"Valid for: {valid}.")
        judged = self._page.judgement()
        only_would_be = self.facts.inputs.simulated and isinstance(judged, Outcome)
        yield _statement(f"Decision rule: {conformity_words(self.facts)}.", "ISO 14253-1",
                         conformity=None if only_would_be else CONFORMITY.get(judged))  # fmt: skip
        yield _statement(f"Before and after adjustment: {adjustment_words(self.facts)}.")
        yield _statement("The results relate only to the item described and to its state when it "
                         "was measured. No accreditation is claimed by the software.")  # fmt: skip

    def results(self) -> Element:
        budget = target_budget(self.facts.log, self.facts.run)
        results = [
            _result("3-D position error of the tool point", "hilcell_error", self._errors()),
            _result("Orientation error of the tool", "hilcell_turn", self._turns()),
            _result("95 % bounds of corrected targets", "hilcell_bound", _bounds(budget)),
            _result("Frames in {W}", "hilcell_frame", map(_frame, Tables(self.facts).posed())),
        ]
        return dcc("measurementResults", dcc(
            "measurementResult", text("name", title(self.facts)),
            dcc("usedMethods", dcc(
                "usedMethod", text("name", "hilcell " + self.facts.inputs.procedure),
                text("description", procedure_words(self.facts)), dcc("norm", "JCGM 100:2008"))),
            dcc("usedSoftware", *(_software(*each) for each in self.facts.inputs.versions.items())),
            dcc("measuringEquipments", *self._equipment()),
            dcc("influenceConditions", *self._air()),
            dcc("results", *(each for each in results if each is not None)),
        ))  # fmt: skip

    def _equipment(self) -> Iterator[Element]:
        for each in self._page.instrument_rows():
            yield dcc("measuringEquipment", text("name", each.instrument), dcc("model", each.model),
                      dcc("identifications",
                          identification("manufacturer", each.serial, "serial number"),
                          identification("other", each.certificate, "calibration certificate")),
                      )  # fmt: skip

    def _air(self) -> Iterator[Element]:
        air = {
            "air temperature": ("basic_temperature", CELSIUS),
            "air pressure": ("basic_pressure", HECTOPASCAL),
            "relative humidity": ("basic_humidityRelative", PERCENT),
        }
        for each in Tables(self.facts).air():
            ref, unit = air[each.name]
            ends = (("Min", "smallest", each.values.min()), ("Max", "largest", each.values.max()))
            yield dcc("influenceCondition", text("name", each.name), dcc("data", *(
                quantity(f"{words} at the tracker", real(float(value), unit), ref=ref + end)
                for end, words, value in ends)), refType=ref)  # fmt: skip
        if not Tables(self.facts).air():
            words = conditions_words(self.facts)
            yield dcc("influenceCondition", text("name", "air"), dcc("data", text("text", words)))

    def _errors(self) -> Iterator[Element]:
        judged = self._page.judged_places()
        for row in Tables(self.facts).validated_rows():
            found = (
                self._page.results_at(row.place)
                if row.way == Sent.CHOSEN and row.place in judged
                else ()
            )
            yield dcc("list", text("name", f"{row.place}, {row.how}"),
                      *self._figures(row, *(self._verdict(each) for each in found)),
                      dcc("influenceConditions", _adjustment(row.way, row.how)),
                      refType=f"hilcell_{row.way}")  # fmt: skip

    def _figures(
        self, row: Validated, mean: Element | None = None, largest: Element | None = None
    ) -> Iterator[Element]:
        """Yield the figures of one series, the verdicts on its mean and its largest with them.

        |e| of a target changes by no more than its position, so U of the largest is that of the
        95 % quantile, too.
        """
        found, guard = row.errors.figures, guard_of(self.facts.log, len(row.errors))
        yield quantity("targets", real(len(row.errors), ONE), ref="hilcell_targets")
        yield quantity("mean", real(found.mean, MM, guard.mean_mm), mean, ref="hilcell_mean")
        yield quantity("95 % below", real(found.p95, MM, guard.max_mm), ref="hilcell_p95")
        yield quantity("largest", real(found.max, MM, guard.max_mm), largest, ref="hilcell_largest")

    def _turns(self) -> Iterator[Element]:
        """Yield the angle from the nominal orientation by series, where it was measured."""
        for place, way, turned in Tables(self.facts).oriented():
            words, found = series_name(way, self.facts), turned.figures
            names = (
                ("mean", found.mean_deg, "mean"),
                ("95 % below", found.p95_deg, "p95"),
                ("largest", found.max_deg, "largest"),
            )
            yield dcc(
                "list", text("name", f"{place}, {words}"),
                quantity("targets", real(len(turned), ONE), ref="hilcell_targets"),
                *(quantity(name, real(value, DEGREE), ref=f"hilcell_{ref}")
                  for name, value, ref in names),
                dcc("influenceConditions", _adjustment(way, words)), refType=f"hilcell_{way}",
            )  # fmt: skip

    def _verdict(self, result: Result) -> Element:
        """Return a figure's limit, and whether it is kept; a simulated one only would be."""
        limit = quantity("limit", real(result.limit_mm, MM), ref="hilcell_limit")
        outcome = result.outcome or Outcome.UNDECIDED  # of a bound, which is not judged
        words, conforms = f"limit {result.limit_mm:g} mm: {outcome.short}", CONFORMITY[outcome]
        real_one = not self.facts.inputs.simulated
        return dcc("measurementMetaData", dcc(
            "metaData", text("declaration", words if real_one else f"{words}, if it were real"),
            _given("conformity", conforms if real_one else ""), dcc("data", limit),
        ))  # fmt: skip


def _software(name: str, version: str) -> Element:
    numbered = re.compile(r"\d{1,3}(\.\d{1,3}){0,3}")
    release = f"v{version}" if numbered.fullmatch(version) else version
    return dcc("software", text("name", name), dcc("release", release or NOT_STATED))


def _person(name: str, role: str, signs: str) -> Element:
    return dcc("respPerson", dcc("person", text("name", name)), dcc("role", role),
               dcc("mainSigner", signs))  # fmt: skip


def _statement(words: str, norm: str = "", **facts: str | None) -> Element:
    """Return a statement; the schema gives the order: traceable, norm, words, valid, conformity."""
    after = [dcc(name, facts.get(name)) for name in ("valid", "conformity") if facts.get(name)]
    return dcc("statement", _given("traceable", facts.get("traceable")), _given("norm", norm),
               text("declaration", words), *after)  # fmt: skip


def _given(name: str, value: str | None) -> Element | None:
    return dcc(name, value) if value else None


# -- results ---------------------------------------------------------------------------------------


def _result(name: str, ref: str, lists: Iterable[Element]) -> Element | None:
    found = list(lists)
    return dcc("result", text("name", name), dcc("data", *found), refType=ref) if found else None


def _adjustment(way: Sent, words: str) -> Element:
    status = "beforeAdjustment" if way == Sent.BEFORE else "afterAdjustment"
    return dcc("influenceCondition", text("name", "adjustment"), dcc("status", status),
               dcc("data", text("text", words)))  # fmt: skip


def _bounds(budget: TargetBudget) -> Iterator[Element]:
    """Yield the 95 % bounds of any target in use, and how many targets kept theirs."""
    for place in placed(budget):
        figures = (
            ("bound in use, mean", place.use(np.mean), MM, "hilcell_boundMean"),
            ("bound in use, largest", place.use(np.max), MM, "hilcell_boundLargest"),
            ("targets within their own bound", place.validated(lambda each: 100 * each.share),
             PERCENT, "hilcell_inside"),
        )  # fmt: skip
        yield dcc("list", text("name", place.name), *(
            quantity(words, real(value, unit), ref=ref)
            for words, value, unit, ref in figures if value is not None
        ))  # fmt: skip


def _frame(frame: Posed) -> Element:
    units = (MM, MM, MM, DEGREE, DEGREE, DEGREE)
    return dcc("list", text("name", frame.name), *(
        quantity(name, real(float(value), unit), ref=f"hilcell_{name}")
        for name, value, unit in zip("xyzABC", frame.zyx, units, strict=True)
    ))  # fmt: skip
