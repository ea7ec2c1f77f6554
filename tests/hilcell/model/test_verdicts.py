"""Verdicts: read as they were written, decided by one rule, and those of plug-ins as they are."""

from __future__ import annotations

import json
import math
from pathlib import Path
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from hilcell.model.outcome import Figure, Outcome, gravest, outcome_of
from hilcell.model.records import fact_of
from hilcell.model.verdicts import (
    VERDICTS,
    Judged,
    OtherVerdict,
    PoseTested,
    Verdict,
    decode_verdict,
    verdict_title,
    verdict_type,
)
from hilcell.report.facts import read_facts
from hilcell.report.tables import Tables
from hilcell.run.cell_session import CellSession
from tests.hilcell import verdicts
from tests.hilcell.report.journals import Writer
from tests.hilcell.run.bed import Bed
from tests.hilcell.run.rig import Points, procedure
from tests.hilcell.verdicts import JUDGED, REDO, SIGN, plain
from tests.whole.bench import command

KINDS = sorted(set(VERDICTS.values()), key=lambda kind: kind.__name__)
LENGTHS_MM = st.floats(-1e3, 1e3)


def key_of(kind: type[Verdict]) -> str:
    """Return a key of a type: one that begins keys is completed."""
    key = kind.keys[0]
    return f"{key}x" if key[-1] in ". " else key


# -- journal and types -----------------------------------------------------------------------------


@pytest.mark.parametrize(("key", "verdict"), verdicts.VERDICTS.items())
def test_a_verdict_is_read_as_it_was_written(key: str, verdict: Verdict) -> None:
    text = msgspec.json.encode(verdict)
    read = decode_verdict(key, msgspec.json.decode(text))
    assert type(read) is type(verdict)
    assert read == verdict
    assert msgspec.json.encode(read) == text
    assert read.text
    assert read.why


def test_the_samples_are_of_all_types() -> None:
    assert {type(each) for each in verdicts.VERDICTS.values()} == set(KINDS)


def made_of(hint: Any) -> st.SearchStrategy[Any]:
    """Return values of a type, with numbers that JSON has."""
    if hint is Any:
        return st.none() | st.booleans() | st.integers(-9, 9) | st.text(max_size=5)
    if hint is float:
        return st.floats(allow_nan=False, allow_infinity=False)
    if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        hints = get_type_hints(hint)
        return st.builds(
            hint, **{each.name: made_of(hints[each.name]) for each in msgspec.structs.fields(hint)}
        )
    origin = get_origin(hint)
    if origin is Literal:
        return st.sampled_from(get_args(hint))
    kinds = [made_of(each) for each in get_args(hint) if each is not ...]
    if origin is list:
        return st.lists(kinds[0], max_size=3)
    if origin is dict:
        return st.dictionaries(*kinds, max_size=3)
    if origin is tuple and ... in get_args(hint):
        return st.lists(kinds[0], max_size=3).map(tuple)
    if origin is tuple:
        return st.tuples(*kinds)
    return st.one_of(kinds) if origin in (Union, UnionType) else st.from_type(hint)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_any_verdict_of_a_type_is_read_as_it_was_written(kind: type[Verdict]) -> None:
    @given(made_of(kind))
    def check(verdict: Verdict) -> None:
        body = msgspec.json.decode(msgspec.json.encode(verdict))
        assert fact_of("verdict", key_of(kind), body) == verdict

    check()


@pytest.mark.parametrize(("key", "verdict"), verdicts.VERDICTS.items())
def test_a_key_has_the_type_of_its_whole_name_or_of_its_beginning(
    key: str, verdict: Verdict
) -> None:
    assert verdict_type(key) is type(verdict)


@pytest.mark.parametrize(
    "key", ["validation", "validated.S1", "fitted", "signs", "conformance", "revisits.x", "own", ""]
)
def test_a_key_that_only_resembles_a_declared_one_is_a_plug_in_s(key: str) -> None:
    assert verdict_type(key) is None


def test_titles_are_words() -> None:
    assert verdict_title("recheck") == "re-check"
    assert verdict_title("revisits.closing") == "revisited poses at the end"
    assert verdict_title("glue-bond") == "glue bond"


@pytest.mark.parametrize(
    "body",
    [
        {},
        {"holds": "yes"},
        plain(JUDGED) | {"outcome": "other"},
        plain(JUDGED) | {"mean_mm": "0.1"},
        {name: value for name, value in plain(JUDGED).items() if name != "decision"},
    ],
)
def test_a_body_that_is_no_verdict_is_refused(body: dict[str, object]) -> None:
    with pytest.raises(msgspec.ValidationError):
        decode_verdict("targets", body)


# -- figures ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "U", "outcome"),
    [
        (0.08, 0.02, Outcome.ACCEPTED),
        (0.09, 0.02, Outcome.UNDECIDED),
        (0.11, 0.02, Outcome.UNDECIDED),
        (0.13, 0.02, Outcome.REJECTED),
        (0.1, None, Outcome.ACCEPTED),
        (0.1001, None, Outcome.REJECTED),
        (math.nan, 0.02, Outcome.REJECTED),
        (math.inf, 0.02, Outcome.REJECTED),
        (0.0, math.nan, Outcome.REJECTED),
        (None, 0.02, Outcome.REJECTED),
        (None, None, Outcome.REJECTED),
    ],
)
def test_a_figure_keeps_its_limit_with_its_uncertainty(
    value: float | None, U: float | None, outcome: Outcome
) -> None:
    figure = Figure("mean", value, "mm", 0.1, U)
    assert figure.outcome is outcome
    assert figure.text.endswith(", limit 0.1 mm")


@pytest.mark.parametrize("value", [0.5, math.nan, None])
def test_a_figure_without_a_limit_is_accepted(value: float | None) -> None:
    assert Figure("mean", value, "mm").outcome is Outcome.ACCEPTED


@given(LENGTHS_MM, LENGTHS_MM, st.floats(0.0, 1e3), st.floats(0.0, 1e3))
def test_a_larger_value_is_never_judged_better(
    value: float, limit: float, U: float, more: float
) -> None:
    order = list(Outcome)
    both = [order.index(outcome_of(each, limit, U)) for each in (value, value + more)]
    assert both[1] <= both[0]


def test_the_gravest_outcome_is_the_worst() -> None:
    assert gravest([]) is Outcome.ACCEPTED
    assert gravest(reversed(Outcome)) is Outcome.REJECTED
    assert gravest([Outcome.ACCEPTED, Outcome.UNDECIDED]) is Outcome.UNDECIDED


def test_a_figure_says_value_uncertainty_and_limit() -> None:
    figure = Figure("mean", 0.031, "mm", 0.1, 0.0042)
    assert figure.text == "mean 0.0310 mm (U 0.0042), limit 0.1 mm"
    assert replace(JUDGED, mean_mm=0.031).text.startswith(
        "mean 0.0310 mm (U 0.0400), limit 0.12 mm; largest error 0.1000 mm (U 0.0500), limit 0.3 mm"
    )


def test_an_orientation_that_is_not_known_keeps_no_limit() -> None:
    """NaN is null in JSON."""
    written = replace(JUDGED, max_deg=math.nan, max_tolerance_deg=0.05, max_U_deg=math.nan)
    read = decode_verdict("targets", msgspec.json.decode(msgspec.json.encode(written)))
    assert isinstance(read, Judged)
    assert read.max_deg is None
    assert read.orientation is not None
    assert math.isnan(read.orientation.max_deg)
    assert read.figures[-1].outcome is Outcome.REJECTED
    assert "orientation not known" in read.text


def test_a_characteristic_that_was_not_measured_keeps_no_limit() -> None:
    (figure,) = PoseTested(holds=False, rd_limit_mm=0.1).figures
    assert figure.outcome is Outcome.REJECTED


@pytest.mark.parametrize(
    ("value", "U", "words"),
    [
        (0.24, 0.04, "exceeds 0.15 mm by more than its U of 0.0400 mm"),
        (0.24, None, "exceeds 0.15 mm"),
        (0.17, 0.04, "exceeds 0.15 mm, but by less than its U of 0.0400 mm"),
        (0.14, 0.04, "keeps 0.15 mm, but not with its U of 0.0400 mm added"),
    ],
)
def test_a_figure_says_the_rule_by_which_it_fails(
    value: float, U: float | None, words: str
) -> None:
    figure = Figure("mean", value, limit=0.15, U=U)
    assert figure.why == f"mean {value:.4f} mm {words}"


def test_what_decided_is_said_alone() -> None:
    assert verdicts.REJECTED.why == "mean 0.2000 mm exceeds 0.12 mm by more than its U of 0.0400 mm"
    assert JUDGED.why == JUDGED.decision
    few = replace(JUDGED, holds=False, decided=Outcome.UNDECIDED, decision="too few targets")
    assert few.why == "too few targets"
    assert verdicts.SUSPECTED.why == verdicts.SUSPICION.text


# -- a run -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("key", "verdict"),
    [("recheck", SIGN), ("sign", REDO), ("validation", JUDGED), ("own", SIGN),
     ("sign", OtherVerdict(holds=True, facts={}))],
)  # fmt: skip
def test_a_run_judges_by_the_type_of_the_key_alone(bed: Bed, key: str, verdict: Verdict) -> None:
    bed.run(procedure(Points(1, lambda session, number: session.judge(key, verdict))))
    assert f"{key!r} is no key of {type(verdict).__name__}" in bed.log().fault


def test_a_plug_in_cannot_write_a_declared_verdict_that_no_reader_could_read(bed: Bed) -> None:
    def act(session: CellSession, number: int) -> None:
        session.verdict("fit", holds=True)

    assert bed.run(procedure(Points(1, act))) == 5
    assert "expected a verdict of another key than 'fit'" in bed.log().fault


BOND = {"worst_mm": 0.25, "count": 3, "dry": True, "rows": [1, 2]}


def test_a_verdict_of_a_plug_in_passes_through_journal_show_and_export(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "r").began()
    writer.journal.append("verdict", "glue-bond", {"holds": False} | BOND)
    folder = writer.ended(code=1)
    facts = read_facts(folder)
    assert facts.log.verdicts == {"glue-bond": OtherVerdict(holds=False, facts=BOND)}
    (row,) = Tables(facts).verdicts().texts()
    assert row == ["glue bond", "fails", "worst 0.2500 mm, count 3, dry yes"]
    shown = json.loads(command("show", "r", "--json", "--runs", tmp_path).stdout)
    assert shown["verdicts"]["glue-bond"] == {"holds": False} | BOND
    out = tmp_path / "verdicts"
    done = command("export", "r", "--runs", tmp_path, "--json", "-o", out)
    assert done.returncode == 0, done.stderr
    assert {"holds": False} | BOND in json.loads(out.read_text())["verdicts"].values()
