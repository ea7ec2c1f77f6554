"""Steps for the person at a controller: a text with one paragraph a step, filled in for a cell."""

from __future__ import annotations

from collections.abc import Mapping

from hilcell.decoding import typed


def steps(text: str, **values: object) -> list[str]:
    """Return the paragraphs of a text, each on one line, with ``{names}`` replaced by values."""
    return [" ".join(each.split()).format(**values) for each in text.strip().split("\n\n")]


def address(options: Mapping[str, object]) -> str:
    """Return the controller's address in brackets, or "" where it is not known."""
    host = options.get("host", "")
    return f" (its address there: {host})" if host else ""


def reflector(options: Mapping[str, object]) -> str:
    """Return the place of the reflector's centre on the flange, or "" where it is not known."""
    if "smr_mm" not in options:
        return ""
    smr_mm = typed(options["smr_mm"], tuple[float, float, float])
    return ": " + ", ".join(f"{axis} {mm:.3f} mm" for axis, mm in zip("XYZ", smr_mm, strict=True))
