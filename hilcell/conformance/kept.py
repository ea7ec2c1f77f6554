"""One test a promise of the port whose driver ``--hilcell-driver`` names."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from hilcell.conformance.kit import PORT_OF, driver_cell, promises_of
from hilcell.conformance.promise import Promise
from hilcell.conformance.trial import Trial


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Make a test of each promise of the port."""
    group = _named(metafunc.config)[0]
    promises = promises_of(PORT_OF[group])
    metafunc.parametrize("promise", promises, ids=[promise.name for promise in promises])


@pytest.fixture(scope="session")
def trial(request: pytest.FixtureRequest, pytestconfig: pytest.Config) -> Iterator[Trial]:
    """Return the driver on trial; with xdist, whose processes share the tests, nothing begins."""
    group, name = _named(pytestconfig)
    sets = dict(each.split("=", 1) for each in pytestconfig.getoption("--hilcell-set"))
    cell = driver_cell(pytestconfig.getoption("--hilcell-cell"), PORT_OF[group], name, sets)
    with Trial(cell, PORT_OF[group]) as trial:
        if not hasattr(pytestconfig, "workerinput"):
            trial.begin(_selected(request.session))
        yield trial


def test_promise(promise: Promise, trial: Trial) -> None:
    """Judge one promise."""
    outcome = trial.judge(promise)
    if outcome.verdict == "not applicable":
        pytest.skip(outcome.why)
    if outcome.verdict == "broken":
        pytest.fail(f"{promise.sentence}\n{outcome.why}", pytrace=False)


def _selected(session: pytest.Session) -> Iterator[Promise]:
    """Yield the promises that this session will judge."""
    for item in session.items:
        promise = item.callspec.params.get("promise") if hasattr(item, "callspec") else None
        if isinstance(promise, Promise):
            yield promise


def _named(config: pytest.Config) -> tuple[str, str]:
    group, colon, name = str(config.getoption("--hilcell-driver")).partition(":")
    if group not in PORT_OF or not (colon and name):
        raise pytest.UsageError(
            f"--hilcell-driver: {'|'.join(PORT_OF)}:NAME is wanted, found {group}{colon}{name}"
        )
    return group, name
