"""The campaign of fuzzing can fail: a parser that raises or hangs is found and said."""

from __future__ import annotations

import signal
from typing import Any

import pytest

from campaigns.fuzz import fuzzer
from campaigns.fuzz.campaign import NAMES, Fuzzed, read_output, report
from campaigns.fuzz.parsers import PARSERS, Parser


def refuses(data: bytes) -> None:
    raise ValueError("declared")


def breaks(data: bytes) -> None:
    raise KeyError("not declared")


def hangs(data: bytes) -> None:
    signal.raise_signal(signal.SIGALRM)  # as after `HANG_S`


@pytest.mark.parametrize(
    ("feed", "code", "says"),
    [(refuses, 0, "Done 50 runs"), (breaks, 1, "FOUND KeyError"), (hangs, 1, "FOUND TimeoutError")],
)
def test_what_is_not_declared_is_found(
    feed: Any, code: int, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    parser = Parser("x", feed, (ValueError,), lambda: [b"abc"])
    assert fuzzer.mutate(parser, 50, 30, 1) == code
    said = capsys.readouterr().out
    assert says in said
    found = read_output("x", "mutation", code, said)
    assert bool(found.found) == bool(code)
    assert report([found]) == (not code)


@pytest.mark.parametrize(
    ("code", "said"),
    [
        (77, "=== Uncaught Python exception: ===\nKeyError: 1\n"),
        (70, "==1== ERROR: libFuzzer: timeout after 20 seconds\n"),
        (0, ""),  # it has died before it began
        (1, "Done 10 runs in 1 second(s)"),
    ],
)
def test_what_a_guided_fuzzer_finds_is_said(code: int, said: str) -> None:
    assert not report([read_output("x", "atheris", code, said)])


def test_a_guided_run_is_read() -> None:
    said = "#200 DONE   cov: 41 ft: 53 corp: 15/364b\nDone 200 runs in 3 second(s)\n"
    assert read_output("x", "atheris", 0, said) == Fuzzed("x", "atheris", 200, 3, 41)


@pytest.mark.parametrize("name", NAMES)
def test_every_parser_takes_its_samples_and_a_few_mutations(name: str) -> None:
    parser = PARSERS[name]
    for sample in parser.samples():
        parser.take(sample)
    assert fuzzer.mutate(parser, 5, 5, 1) == 0


def test_every_parser_is_fuzzed() -> None:
    assert set(NAMES) == set(PARSERS)
