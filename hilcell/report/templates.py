"""The templates of pages, filled in so that no text of a journal or a file acts in a browser."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from hilcell.clean import harmless

if TYPE_CHECKING:
    from jinja2 import Environment


@cache  # to compile the templates takes longer than to fill them in
def environment(package: str = "hilcell.report") -> Environment:
    """Return jinja2's environment: every value is escaped and in one line, none may be missing.

    Templates of another ``package`` may include those of the reports.
    """
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    def finalize(value: object) -> object:
        return harmless("; ".join(value.splitlines())) if type(value) is str else value

    made = Environment(
        loader=ChoiceLoader([PackageLoader(each, ".") for each in (package, "hilcell.report")]),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=finalize,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters["trusted"] = Markup  # for hilcell's own SVG only
    return made
