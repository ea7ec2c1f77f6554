"""The verdicts of a run: each in words, with the unit and the limit of every figure."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

import msgspec

from hilcell.calibration.causes import RISK
from hilcell.calibration.decision import Judged
from hilcell.calibration.instrument import LengthFound
from hilcell.calibration.iso9283 import CHARACTERISTICS, ISO
from hilcell.calibration.recheck import WORDS
from hilcell.calibration.since import Parameter
from hilcell.journal.calibration_facts import SINCE, VALIDATION
from hilcell.journal.key_words import verdict_words
from hilcell.present.table import Column, Table
from hilcell.report.facts import Facts
from hilcell.typed import typed

Body = Mapping[str, Any]

UNITS = {
    "mm": " mm", "s": " s", "c": " °C", "k": " K", "deg": "°", "urad": " µrad", "percent": " %",
}  # fmt: skip
_SIGNS = {"<=": "≤", r"\+-": "±", r" deg\b": "°"}


def verdicts(facts: Facts) -> Table:
    """Return the verdicts, with the figures behind them."""
    return Table(VERDICTS, facts.log.verdicts.items(), "Verdicts")


def figures_words(key: str, body: Body) -> str:
    """Return the figures of a verdict in words, plain names and values of one not known here."""
    return with_signs(_words(key, body))


def deciding_words(key: str, body: Body) -> str:
    """Return what decided a verdict, in words: the figures that do not keep their limit, where it
    is one on targets.
    """
    if key.startswith(VALIDATION) or key == "targets":
        with suppress(msgspec.ValidationError):
            judged = typed(body, Judged)
            if judged.deciding:
                return judged.deciding
    return _words(key, body)


def _words(key: str, body: Body) -> str:
    group = VALIDATION if key.startswith(VALIDATION) else key
    try:
        return FIGURES.get(group, _plain)(body)
    except (KeyError, msgspec.ValidationError):  # another procedure's of that name
        return _plain(body)


def with_signs(words: str) -> str:
    """Return words with the signs of print."""
    for written, shown in _SIGNS.items():
        words = re.sub(written, shown, words)
    return words


VERDICTS: tuple[Column[tuple[str, Body]], ...] = (
    Column("judged", lambda row: verdict_words(row[0])),
    Column("verdict", lambda row: "holds" if row[1]["holds"] else "does not hold"),
    Column("by", lambda row: figures_words(*row)),
)


def _validation(body: Body) -> str:
    judged = typed(body, Judged)
    return f"{judged.figures}: {judged.decision}"


def _revisits(body: Body) -> str:
    chance = f"which chance alone keeps in {100 * (1 - RISK):g} % of runs"
    moved = "".join(f"; suspected: {each}" for each in body["suspected"])
    return (
        "differences from the first visits: of the tests of all poses together and of each cause "
        f"(chi² per degree of freedom, 1 on average by chance), the nearest to its limit has "
        f"{body['ratio']:.2f}; limit {body['limit']:.2f}, {chance}{moved}"
    )


def _reversal(body: Body) -> str:
    both = zip(body["lost_urad"], body["U_urad"], strict=True)
    lost = ", ".join(f"A{axis} {lost:.0f} +- {U:.0f}" for axis, (lost, U) in enumerate(both, 1))
    return (
        f"{body['points']} vertices from both sides, {body['mean_mm']:.3f} mm apart on average, "
        f"{body['max_mm']:.3f} mm at most; lost motion {lost} µrad (U, k = 2), wanted <= "
        f"{body['limit_urad']:g} µrad"
    )


def _sign(body: Body) -> str:
    return (
        f"error of one target {body['before_mm']:.3f} mm as sent, {body['corrected_mm']:.3f} mm "
        f"corrected: {100 * body['ratio']:.0f} % of it, wanted < {100 * body['limit']:.0f} %"
    )


def _fit(body: Body) -> str:
    turned = body.get("orientation")
    return f"{body['method']}, {body['reason']}{f'; orientation {turned}' if turned else ''}"


def _recheck(body: Body) -> str:
    words = str(WORDS.get(body["verdict"], body["verdict"]))
    if body.get("drift_mm") is not None and body.get("drift_u_mm") is not None:
        words += f": drift {body['drift_mm']:.3f} mm, u {body['drift_u_mm']:.3f} mm"
    return f"{words}; {body['doubt']}" if body.get("doubt") else words


def _iso9283(body: Body) -> str:
    found = []
    for of in CHARACTERISTICS:
        if of.limit in body:
            figure, U = (_figure(body[f"{of.key}{part}_{of.unit}"]) for part in ("", "_u95"))
            limit = f"{body[of.limit]:g} {of.unit}"
            found.append(f"{of.key.upper()} {figure} +- {U} {of.unit}, wanted <= {limit}")
    return "; ".join(found)


def _orientation(body: Body) -> str:
    return (
        f"mean error of orientation {body['before_mean_deg']:.4f} deg before, "
        f"{body['mean_deg']:.4f} deg corrected; reflectors moved "
        f"{body['reflectors_moved_mm']:.3f} mm on the flange"
    )


def _lengths(body: Body) -> str:
    found = typed(body["lengths"], list[LengthFound])
    return "; ".join(each.text for each in found)


def _since(body: Body) -> str:
    beyond = "; ".join(each.words for each in typed(body["beyond"], list[Parameter]))
    kept = f"all {body['compared']} parameters are within their limits"
    return f"against the calibration of run {body['before']}: {beyond or kept}"


def _found(what: str) -> Callable[[Body], str]:
    return lambda body: f"{what} {body['found_mm']:.4f} mm, wanted <= {body['limit_mm']:g} mm"


FIGURES: dict[str, Callable[[Body], str]] = {
    VALIDATION: _validation,
    "targets": _validation,
    "revisits": _revisits,
    "revisits.closing": _revisits,
    "reversal": _reversal,
    "sign": _sign,
    "fit": _fit,
    "recheck": _recheck,
    ISO: _iso9283,
    "orientation": _orientation,
    "known-length": _lengths,
    "two-face": lambda body: str(body["words"]),
    "two-face.closing": lambda body: str(body["words"]),
    "reflectors": lambda body: "; ".join(body["wrong"]) or "none differs from the others",
    "suspicions": lambda body: "; ".join(body["suspected"]) or "nothing is suspected",
    SINCE: _since,
    "backlash": _found("backlash"),
    "station-repeatability": _found("largest range of positions held by the strip"),
    "touch": lambda body: f"touched at {body['station']}",
}


def _figure(value: float | None) -> str:
    return "not known" if value is None else f"{value:.3f}"


def _plain(body: Body) -> str:
    """Return the plain facts of a record: names without underscores, figures with their unit."""
    return ", ".join(
        _with_unit(name, value)
        for name, value in body.items()
        if name != "holds" and not isinstance(value, (dict, list, type(None)))
    )


def _with_unit(name: str, value: object) -> str:
    words, _, last = name.rpartition("_")
    unit = UNITS.get(last, "") if words else ""
    return f"{(words if unit else name).replace('_', ' ')} {_text(value)}{unit}"


def _text(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4f}" if isinstance(value, float) else str(value)
