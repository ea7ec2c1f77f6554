"""One test a promise of the port whose driver ``--hilcell-driver`` names."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from hilcell.conformance.kit import promises_of
from hilcell.conformance.pytest_options import options_of
from hilcell.conformance.trial import Promise, Trial


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Make a test of each promise of the port."""
    promises = promises_of(options_of(metafunc.config)[0])
    metafunc.parametrize("promise", promises, ids=[promise.name for promise in promises])


@pytest.fixture(scope="session")
def trial(request: pytest.FixtureRequest, pytestconfig: pytest.Config) -> Iterator[Trial]:
    """Return the driver on trial; with xdist, whose processes share the tests, nothing begins."""
    port, cell = options_of(pytestconfig)
    with Trial(cell, port) as trial:
        if not hasattr(pytestconfig, "workerinput"):
            stated = (
                item.callspec.params.get("promise") if hasattr(item, "callspec") else None
                for item in request.session.items
            )
            trial.begin(each for each in stated if isinstance(each, Promise))
        yield trial


def test_promise(promise: Promise, trial: Trial) -> None:
    """Judge one promise."""
    outcome = trial.judge(promise)
    if outcome.verdict == "not applicable":
        pytest.skip(outcome.why)
    if outcome.verdict == "broken":
        pytest.fail(f"{promise.sentence}\n{outcome.why}", pytrace=False)
