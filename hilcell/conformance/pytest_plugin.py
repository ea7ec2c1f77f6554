"""``pytest --hilcell-driver=robots:NAME [--hilcell-cell paper]``: the kit as tests.

One test a promise, on the simulated device of that name. Nothing else is loaded without the option.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("hilcell", "promises of hilcell's ports")
    group.addoption(
        "--hilcell-driver",
        metavar="rails|robots|trackers:NAME",
        help="put this driver through the promises of its port, on its simulated device",
    )
    group.addoption(
        "--hilcell-cell",
        metavar="CELL",
        default="paper",
        help="the cell in which the device is simulated (default: paper)",
    )
    group.addoption(
        "--hilcell-set",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="a value of the cell, as --set of hilcell",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Collect the promises: beside the tests that were named, or in place of all.

    Raises `pytest.UsageError` where driver, cell or a value of it is not known.
    """
    if config.getoption("--hilcell-driver") is None:
        return
    from hilcell.conformance.port_tests import options_of

    options_of(config)
    if config.args_source is not config.ArgsSource.ARGS:
        config.args.clear()
    config.args.append(str(Path(__file__).with_name("port_tests.py")))
