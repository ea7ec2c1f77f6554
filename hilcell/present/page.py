"""Pages of HTML from templates: a table's macro is ``table.html.j2``, of every room."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from hilcell.clean import harmless

if TYPE_CHECKING:
    from jinja2 import Environment


@cache  # to compile the templates takes longer than to fill them in
def environment(*packages: str) -> Environment:
    """Return jinja2's environment: every value is escaped and in one line, none may be missing.

    Templates are those of the packages, the first first, and of this room.
    """
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    def finalize(value: object) -> object:
        return harmless("; ".join(value.splitlines())) if type(value) is str else value

    made = Environment(
        loader=ChoiceLoader([PackageLoader(each, ".") for each in (*packages, __package__)]),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=finalize,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters["trusted"] = Markup  # for hilcell's own SVG only
    return made
