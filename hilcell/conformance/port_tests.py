"""One test a promise of the port whose driver ``--hilcell-driver`` names. The plug-in's options are
checked before collection: every mistake is one usage error.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import pytest

from hilcell.cell.devices import check_options, load_entry
from hilcell.cell.file import Cell
from hilcell.conformance.exercise import Port
from hilcell.conformance.promises import PORT_OF, driver_cell, promises_of
from hilcell.conformance.trial import Promise, Trial
from hilcell.errors import HilcellError


def options_of(config: pytest.Config) -> tuple[Port, Cell]:
    driver, where, sets = (
        config.getoption(f"--hilcell-{name}") for name in ("driver", "cell", "set")
    )
    return chosen(driver, where, sets)


def chosen(driver: str, where: str, assignments: Sequence[str]) -> tuple[Port, Cell]:
    """Port and cell of the driver on trial; raises `pytest.UsageError`."""
    group, colon, name = driver.partition(":")
    if group not in PORT_OF or not (colon and name):
        raise pytest.UsageError(
            f"--hilcell-driver: expected {'|'.join(PORT_OF)}:NAME, got {driver}"
        )
    port = PORT_OF[group]
    try:
        load_entry(group, name)
    except HilcellError as error:
        act = f"install the driver's package, or name one of {group} that is installed"
        raise pytest.UsageError(f"--hilcell-driver={group}:{name}: {error}\n{act}") from None
    sets: dict[str, str] = {}
    for each in assignments:
        key, sign, value = each.partition("=")
        if not (key and sign):
            raise pytest.UsageError(f"--hilcell-set: expected KEY=VALUE, got {each}")
        sets[key.strip()] = value.strip()
    if sets.get(f"{port}.driver", name) != name:
        raise pytest.UsageError(
            f"--hilcell-set: {port}.driver={sets[f'{port}.driver']}, but --hilcell-driver="
            f"{group}:{name} is on trial; leave one of them out"
        )
    said = " ".join(
        [f"--hilcell-cell={where}", *(f"--hilcell-set={k}={v}" for k, v in sets.items())]
    )
    try:
        cell = driver_cell(where, port, name, sets)
        check_options(cell)
    except HilcellError as error:
        act = f"name a simulated cell to which {name} belongs, and values that it has"
        raise pytest.UsageError(f"{said}: {error}\n{act}") from None
    if cell.simulation is None:
        raise pytest.UsageError(
            f"{said}: cell {cell.name} is real: nothing simulates its devices; name a simulated "
            "cell, or judge it by `hilcell run conformance --cell CELL`"
        )
    return port, cell


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Make a test of each promise of the port."""
    promises = promises_of(options_of(metafunc.config)[0])
    metafunc.parametrize("promise", promises, ids=[promise.name for promise in promises])


@pytest.fixture(scope="session")
def trial(request: pytest.FixtureRequest, pytestconfig: pytest.Config) -> Iterator[Trial]:
    """The driver on trial; with xdist, whose processes share the tests, nothing begins."""
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
    outcome = trial.judge(promise)
    if outcome.verdict == "not applicable":
        pytest.skip(outcome.why)
    if outcome.verdict == "broken":
        pytest.fail(f"{promise.sentence}\n{outcome.why}", pytrace=False)
