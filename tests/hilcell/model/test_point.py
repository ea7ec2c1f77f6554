"""Points in words: every kind that a procedure measures has an entry."""

import ast
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import hilcell
import procedures
from hilcell.calibration.diagnosis import CLOSING, REVISIT
from hilcell.model.point import KINDS
from hilcell.report.facts import read_facts
from tests.whole.golden import GoldenRuns

OF_THE_CALLER = {"kind", "id"}  # the kinds of second visits, and kinds that a journal names


def kinds_made() -> Iterator[str]:
    """Yield the kind of every point that the source makes, by a word or the name of a constant."""
    for package in (hilcell, procedures):
        folder = Path(str(package.__file__)).parent
        for file in folder.rglob("*.py"):
            text = file.read_text("utf-8")
            for call in ast.walk(ast.parse(text)) if "PointId(" in text else ():
                if not isinstance(call, ast.Call) or ast.unparse(call.func) != "PointId":
                    continue
                match call.args[:1]:
                    case [ast.Constant(value=str(kind))]:
                        yield kind
                    case [ast.Name(id=name)] if name not in OF_THE_CALLER:
                        parts = file.relative_to(folder.parent).with_suffix("").parts
                        yield getattr(import_module(".".join(parts)), name)


def test_every_kind_that_a_procedure_measures_has_words() -> None:
    kinds = {*kinds_made(), REVISIT, CLOSING}
    assert {"validate", "campaign", "survey", "six", "repeat", "iso9283", "oriented"} <= kinds
    assert kinds <= KINDS.keys()


def test_the_points_of_a_run_are_counted_in_words(golden: GoldenRuns) -> None:
    points = read_facts(golden["small"].folder).log.points.values()
    assert {point.id.kind for point in points} <= KINDS.keys()
    counted = {point.id.counted_with for point in points}
    assert {"targets, corrected", "sign check, as sent", "repeated poses, place 1"} <= counted
    assert not [words for words in counted if "_" in words]
