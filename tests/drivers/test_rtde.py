from __future__ import annotations

import struct

import numpy as np
import pytest

from drivers.universal_robots import rtde
from drivers.universal_robots.rtde import (
    INPUTS,
    OUTPUTS,
    Kind,
    Order,
    Packages,
    Recipe,
    RtdeError,
    UrState,
)

RECIPE = Recipe(1, ("timestamp", "actual_q", "robot_mode"), ("DOUBLE", "VECTOR6D", "INT32"))
DATA = struct.pack(">B7di", 1, 12.5, *range(6), 7)


def test_golden_bytes() -> None:
    assert rtde.request_version().hex() == "0005560002"
    (answer,) = Packages().feed(bytes.fromhex("00045601"))
    assert answer == (Kind.VERSION, b"\x01")
    assert rtde.accepted(answer[1])
    assert rtde.encode(Kind.START).hex() == "000353"
    outputs = rtde.request_outputs(("timestamp", "actual_q"), 125.0)
    assert outputs == b"\x00\x1d\x4f\x40\x5f\x40\x00\x00\x00\x00\x00timestamp,actual_q"
    assert rtde.controller_version(struct.pack(">4I", 5, 12, 0, 7)) == "5.12.0.7"


def test_packages_are_put_together_however_they_come() -> None:
    wire = rtde.encode(Kind.DATA, DATA) + rtde.encode(Kind.PAUSE, b"\x01")
    wanted = [(Kind.DATA, DATA), (Kind.PAUSE, b"\x01")]
    assert list(Packages().feed(wire)) == wanted
    for cut in range(1, len(wire)):
        packages = Packages()
        assert [*packages.feed(wire[:cut]), *packages.feed(wire[cut:])] == wanted


@pytest.mark.parametrize(
    "name", ["actual_q", "actual_qd", "actual_TCP_pose", "output_double_register_29"]
)
def test_a_number_that_no_robot_has_is_refused(name: str) -> None:
    values: dict[str, rtde.Numbers] = {
        each: (0.5,) * (6 if each.startswith("actual") else 1) for each in OUTPUTS
    }
    UrState.checked(values, 0.0, 0.0)
    huge = (*values[name][1:], -1e200)
    with pytest.raises(RtdeError, match=name):
        UrState.checked(values | {name: huge}, 0.0, 0.0)


@pytest.mark.parametrize("size", [0, 2, 4097, 65535])
def test_an_impossible_size_is_refused(size: int) -> None:
    with pytest.raises(RtdeError, match=str(size)):
        list(Packages().feed(struct.pack(">HB", size, Kind.DATA)))


def test_data_by_recipe() -> None:
    values = RECIPE.decode(DATA)
    assert values == {"timestamp": (12.5,), "actual_q": (0, 1, 2, 3, 4, 5), "robot_mode": (7,)}
    assert RECIPE.encode(values) == rtde.encode(Kind.DATA, DATA)


@pytest.mark.parametrize("bad", ["nan", "inf", "-inf"])
def test_a_number_that_is_none_is_refused(bad: str) -> None:
    with pytest.raises(RtdeError, match="timestamp"):
        RECIPE.decode(struct.pack(">B7di", 1, float(bad), *range(6), 7))


@pytest.mark.parametrize("payload", [b"", DATA[:-1], DATA + b"\0", b"\2" + DATA[1:]])
def test_data_of_another_recipe_is_refused(payload: bytes) -> None:
    with pytest.raises(RtdeError):
        RECIPE.decode(payload)


def test_what_the_controller_lacks_or_another_holds() -> None:
    recipe = Recipe.from_answer(("a", "b", "c"), b"\x01DOUBLE,NOT_FOUND,IN_USE")
    assert (recipe.lacking(rtde.NOT_FOUND), recipe.lacking(rtde.IN_USE)) == (["b"], ["c"])
    for types in (b"\x01DOUBLE", b""):
        with pytest.raises(RtdeError):
            Recipe.from_answer(("a", "b"), types)


def test_states_are_in_mm_and_rad() -> None:
    numbers: dict[str, rtde.Numbers] = dict.fromkeys(OUTPUTS, (0.0,))
    numbers["actual_TCP_pose"] = (0.5, -0.25, 1.0, 0.0, 0.0, 3.141592653589793)
    numbers["output_double_register_24"] = (0.09,)
    state = UrState.checked(numbers, 1.0, 2.0)
    assert state.pose[:3, 3].tolist() == [500.0, -250.0, 1000.0]
    assert state.pose[0].tolist()[:2] == pytest.approx([-1.0, 0.0], abs=1e-12)
    assert state.tool[0] == pytest.approx(90.0)


def test_registers_of_the_script() -> None:
    values = Order(7, np.arange(6.0), 0.25, stop=True).registers(3)
    assert tuple(values) == INPUTS
    assert [values[name][0] for name in INPUTS] == [7, 1, 3, 1, *range(6), 0.25]
