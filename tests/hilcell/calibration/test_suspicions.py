"""The cause that an error names is the result of the run that it ends."""

import math

import pytest

from hilcell.calibration.suspicions import Suspicion, blamed, suspected_in
from hilcell.errors import DeviceError

STRIP = Suspicion("strip", 1.0, "mm", "slide nest at S300")


def ended_by(**fields: object) -> DeviceError:
    return DeviceError("HC-S10", "Rail", "hold S300", "beside it", fields=fields)


def test_an_error_names_its_cause_by_the_fields_of_a_suspicion() -> None:
    error = ended_by(**STRIP.facts, station="S300")
    assert suspected_in(blamed(error.facts())) == [STRIP]


@pytest.mark.parametrize(
    "facts",
    [
        {},
        ended_by(station="S300").facts(),
        ended_by(cause="strip").facts(),
        ended_by(**STRIP.facts | {"size": math.nan}).facts(),
        ended_by(**STRIP.facts | {"cause": "witchcraft"}).facts(),
    ],
)
def test_an_error_without_a_cause_blames_nothing(facts: dict[str, object]) -> None:
    assert blamed(facts) == {}
    assert suspected_in(blamed(facts)) == []
