"""Uncertainties that a run cannot measure; the laboratory states them in the cell file.

A limit is the half-width of a rectangular distribution (GUM 4.3.7); an angle is 1 sigma.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Self
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import msgspec
from msgspec import Meta

from hilcell.cell.settings import SettingsError, read_text
from hilcell.cell.tables import Frozen, Point, Rate
from hilcell.sanitize import clean

# The file is not trusted: its size is limited and a document type is refused, so no entity is
# expanded or fetched. Supported: DCC 2 and 3, with uncertainties of D-SI 1 and D-SI 2.2.

DCC, SI = "{https://ptb.de/dcc}", "{https://ptb.de/si}"
MM = {"\\metre": 1e3, "\\milli\\metre": 1.0, "\\micro\\metre": 1e-3, "\\nano\\metre": 1e-6}
COVERAGE_FACTOR = 2.0  # about 95 % of a normal distribution (GUM 6.3.3)


class CertificateError(Exception):
    """A certificate that lacks the required statement."""


@dataclass(frozen=True, slots=True)
class InstrumentDcc:
    """A digital calibration certificate; ``words`` are its number, date and laboratory."""

    words: str
    root: Element

    MOST_MM = 10.0  # as a limit in the cell file

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a certificate; raises `CertificateError`."""
        try:
            text = read_text(path)
        except UnicodeDecodeError:
            raise CertificateError("is not UTF-8 text") from None
        except OSError as error:
            raise CertificateError(f"cannot be read: {error.strerror}") from error
        longest = 4_000_000  # characters
        if len(text) > longest:
            raise CertificateError(f"has {len(text)} characters, expected at most {longest}")
        if "<!DOCTYPE" in text:
            raise CertificateError("declares a document type; a DCC has none")
        try:
            root = ElementTree.fromstring(text)  # noqa: S314 - without a document type, see above
        except (ElementTree.ParseError, ValueError) as error:
            raise CertificateError(f"is no XML: {error}") from None
        if root.tag != f"{DCC}digitalCalibrationCertificate":
            raise CertificateError(f"is no DCC: its root is {clean(root.tag)}")
        core = f"{DCC}administrativeData/{DCC}coreData/{DCC}"
        laboratory = f"{DCC}administrativeData/{DCC}calibrationLaboratory/{DCC}contact/{DCC}name/"
        said = (f"{core}uniqueIdentifier", f"{core}endPerformanceDate", f"{laboratory}{DCC}content")
        return cls(", ".join(cls._text(root, path) for path in said), root)

    def largest_error_mm(self, id: str) -> float:
        """Return the largest |error| + U (k = 2) of the quantity with this id.

        The quantity is one or more errors found at the instrument's calibration. They are not
        corrected, so each reading may be off by the largest (GUM F.2.4.5).
        """
        found = [each for each in self.root.iter(f"{DCC}quantity") if each.get("id") == id]
        if len(found) != 1:
            raise CertificateError(f"expected one quantity of the id {id!r}, got {len(found)}")
        lengths = [each for each in found[0].iter() if self._unit(each) in MM]
        if not lengths:
            raise CertificateError(f"quantity {id!r} is no length in {', '.join(MM)}")
        values, expanded = self._values(lengths[0], id)
        largest_mm = MM[self._unit(lengths[0])] * max(
            abs(value) + U for value, U in zip(values, expanded, strict=True)
        )
        if not largest_mm <= self.MOST_MM:
            error = f"{largest_mm:g} mm"
            raise CertificateError(
                f"quantity {id!r}: expected errors <= {self.MOST_MM:g} mm, got {error}"
            )
        return largest_mm

    @staticmethod
    def _text(root: Element, path: str) -> str:
        found = clean(root.findtext(path, ""))
        if not found:
            raise CertificateError(f"does not say {path.rpartition(DCC)[2]}")
        return found

    @staticmethod
    def _unit(quantity: Element) -> str:
        """Return the unit of a D-SI quantity, "" unless it has exactly one."""
        texts = (quantity.findtext(f"{SI}{name}", "") for name in ("unit", "unitXMLList"))
        units = {unit for text in texts for unit in text.split()}
        return units.pop() if len(units) == 1 else ""

    @classmethod
    def _values(cls, quantity: Element, id: str) -> tuple[list[float], list[float]]:
        """Return the values of a quantity and the U (k = 2) of each."""
        values = [
            each for name in ("value", "valueXMLList") for each in cls._floats(quantity, name)
        ]
        pairs = (  # U and its k: of single values and of lists, in D-SI 2.2 and earlier
            [list(cls._floats(quantity, f"{name}{of}")) for name in (U, "coverageFactor")]
            for U in ("valueExpandedMU", "uncertainty")
            for of in ("", "XMLList")
        )
        expanded, factors = next(((U, k) for U, k in pairs if U and k), ([], []))
        if not (values and expanded and min(factors) > 0 and min(expanded) >= 0):
            raise CertificateError(
                f"quantity {id!r} states no value with expanded uncertainty (>= 0) and k > 0"
            )
        sizes = {len(values), len(expanded), len(factors)} - {1}
        if len(sizes) > 1:
            raise CertificateError(
                f"quantity {id!r} has {len(values)} values and {len(expanded)} U"
            )
        count = len(values)
        wide = [U * (count if len(U) == 1 else 1) for U in (expanded, factors)]
        return values, [U * COVERAGE_FACTOR / k for U, k in zip(*wide, strict=True)]

    @staticmethod
    def _floats(quantity: Element, name: str) -> Iterator[float]:
        element = next(quantity.iter(f"{SI}{name}"), None)
        for word in ("" if element is None else element.text or "").split():
            try:
                figure = float(word)
            except ValueError:
                figure = math.nan
            if not math.isfinite(figure):
                raise CertificateError(f"{name}: expected a figure, got {clean(word)!r}")
            yield figure


Limit = Annotated[float, Meta(ge=0, le=10)]
Urad = Annotated[float, Meta(ge=0, le=100_000)]
ID = "#"  # between a file and the id of a quantity in it


class UncertaintyTable(Frozen, frozen=True, kw_only=True):
    """Stated contributions; certificates and data sheets replace the defaults.

    The tracker's limit is ``tracker_limit_mm`` in each direction, plus ``tracker_limit_um_m``
    times the range across the beam. ``arm_growth_um_m_k`` is an upper limit (aluminium), because
    the arm's temperature lags the room's. ``drill_offset_mm`` is the working point relative to the
    reflector's centre, in the axes of {T}. Certificates are the numbers and dates for the report's
    first page; a DCC file contains its own, see `with_certificates`.
    """

    tracker_limit_mm: Limit = 0.015  # the paper's tracker within 10 m (section 5.1)
    tracker_limit_um_m: Rate = 0.0
    smr_centring_limit_mm: Limit = 0.0127  # half a thousandth of an inch, a common grade
    drift_limit_mm: Limit = 0.02  # if the floor nests were not measured again
    arm_growth_um_m_k: Rate = 23.0
    air_range_k: Annotated[float, Meta(ge=0, le=60)] = 4.0  # without a weather station
    lost_motion_urad: Urad = 100.0  # of a reversing axis, from the robot's data sheet
    reversal_limit_mm: Limit = 0.0  # 0: programs approach from below on every axis, like the run
    drill_offset_mm: Point = (0.0, 0.0, 0.0)
    orientation_urad: Urad = 1000.0
    tracker_certificate: str = ""
    smr_certificate: str = ""
    weather_certificate: str = ""
    tracker_dcc: str = ""
    smr_dcc: str = ""
    weather_dcc: str = ""

    @property
    def tracker_source(self) -> str:
        """Return the source of the tracker's limit, "" for an assumption."""
        return f"certificate {self.tracker_certificate}" if ID in self.tracker_dcc else ""

    @property
    def smr_source(self) -> str:
        """Return the source of the centring's limit, "" for an assumption."""
        return f"certificate {self.smr_certificate}" if ID in self.smr_dcc else ""


def with_certificates(stated: UncertaintyTable, folder: Path) -> UncertaintyTable:
    """Return the table completed from the named DCC files; raises `ValueError` as a table does.

    A file names its certificate. With the id of a quantity appended, as in
    ``tracker.xml#length_errors``, the largest of its errors becomes the limit.
    """
    found: dict[str, str | float] = {}
    problems: list[str] = []
    dcc_limits = {"tracker": "tracker_limit_mm", "smr": "smr_centring_limit_mm", "weather": ""}
    for name, limit in dcc_limits.items():
        place, _, id = getattr(stated, f"{name}_dcc").partition(ID)
        if not place:
            continue
        try:
            if getattr(stated, f"{name}_certificate"):
                raise CertificateError(
                    f"names the certificate; so does {name}_certificate: state one"
                )
            certificate = InstrumentDcc.read(folder / place)
            found[f"{name}_certificate"] = certificate.words
            if id and not limit:
                raise CertificateError("names a quantity, which nothing is computed from")
            if id:
                found[limit] = certificate.largest_error_mm(id)
        except CertificateError as reason:
            problems.append(f"uncertainty.{name}_dcc: {place} {reason}")
    if problems:
        raise SettingsError("uncertainty", problems)
    return msgspec.structs.replace(stated, **found) if found else stated
