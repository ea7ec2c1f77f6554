"""One test a promise of the port whose driver ``--hilcell-driver`` names."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from hilcell.conformance.bench import Benches
from hilcell.conformance.kit import PORT_OF, driver_cell, promises_of
from hilcell.conformance.promise import Promise, judge


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Make a test of each promise of the port."""
    group = _named(metafunc.config)[0]
    promises = promises_of(PORT_OF[group])
    metafunc.parametrize("promise", promises, ids=[promise.name for promise in promises])


@pytest.fixture(scope="session")
def benches(pytestconfig: pytest.Config) -> Iterator[Benches]:
    """Return the benches of the driver."""
    group, name = _named(pytestconfig)
    sets = dict(each.split("=", 1) for each in pytestconfig.getoption("--hilcell-set"))
    cell = driver_cell(pytestconfig.getoption("--hilcell-cell"), PORT_OF[group], name, sets)
    with Benches(cell, PORT_OF[group]) as benches:
        yield benches


def test_promise(promise: Promise, benches: Benches) -> None:
    """Judge one promise."""
    outcome = judge(promise, benches.of(paced=promise.paced))
    if outcome.verdict == "not applicable":
        pytest.skip(outcome.why)
    if outcome.verdict == "broken":
        pytest.fail(f"{promise.sentence}\n{outcome.why}", pytrace=False)


def _named(config: pytest.Config) -> tuple[str, str]:
    group, colon, name = str(config.getoption("--hilcell-driver")).partition(":")
    if group not in PORT_OF or not (colon and name):
        raise pytest.UsageError(
            f"--hilcell-driver: {'|'.join(PORT_OF)}:NAME is wanted, found {group}{colon}{name}"
        )
    return group, name
