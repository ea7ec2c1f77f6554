"""Which rows of the paper a run can answer."""

from hilcell.journal.log import Log
from procedures.paper import ROWS, rows_for
from tests.hilcell.alarms.journals import log_of, point

AIR = {"sec5.1.temperature.min", "sec5.1.temperature.max"}


def names_for(log: Log) -> set[str]:
    return {row.name for row in rows_for(log)}


def test_the_rows_of_the_air_need_a_weather_station() -> None:
    every = {row.name for row in ROWS}
    assert names_for(log_of(point("a", None), point("b", 22.0))) == every
    assert names_for(log_of(point("a", None))) == every - AIR
