"""Elements of a Digital Calibration Certificate: one small function writes one of them.

The PTB's schema DCC 3.1.2 gives names and order (namespace ``dcc``), D-SI 2 the quantities
(``si``): a value has its unit, and a measured one U, k and the coverage probability. Lengths are
in ``\\milli\\metre``: digit for digit those of the printed report.
"""

from __future__ import annotations

import math
from xml.etree.ElementTree import Element, indent, tostring

from hilcell.clean import harmless

VERSION = "3.1.2"
ROOT = {
    "xmlns:dcc": "https://ptb.de/dcc",
    "xmlns:si": "https://ptb.de/si",
    "xmlns:xsi": "http://www.w3.org/2001/XMLSchema-instance",
    "xsi:schemaLocation": f"https://ptb.de/dcc https://ptb.de/dcc/v{VERSION}/dcc.xsd",
    "schemaVersion": VERSION,
}
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
COVERAGE = "0.95"

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
    expanded = None if U is None else si(
        "expandedUnc", si("uncertainty", format(U, form)), si("coverageFactor", f"{k:g}"),
        si("coverageProbability", COVERAGE), si("distribution", "normal"),
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
