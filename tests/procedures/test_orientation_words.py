"""What the fit says of the tool's orientation."""

from procedures.fit import _orientation
from tests.hilcell.compensation.test_orientation import CELL, measured


def test_a_model_of_places_leaves_the_orientation_and_says_so() -> None:
    data = measured()
    assert _orientation(CELL, "kinematic", data) == "corrected: kinematic predicts it"
    assert _orientation(CELL, "idw", data) == "left as it is: idw predicts positions only"
    assert _orientation(CELL, "nominal", data) == "left as it is: nominal predicts positions only"
