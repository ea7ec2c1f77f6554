"""500 holes written in each form, read by parsers of the tests, corrected by hilcell's readers."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from drivers.program_text import fixed
from hilcell.compensation.programs import Program, load_program
from hilcell.geometry.frames import poses_from_zyx
from tests.drivers.program_forms import FORMS, Form, correctable, station, texts_of, written

COUNT = 500
forms = pytest.mark.parametrize("form", FORMS, ids=lambda form: form.writer)


@forms
def test_every_form_has_the_same_holes(form: Form) -> None:
    """To 0.001 mm, and to the last digit of its angles."""
    program = station(COUNT, 8.0)
    holes = form.parse(written(form, program)).in_root
    expected = poses_from_zyx(program.base[None])[0] @ poses_from_zyx(program.command.values)
    assert holes.shape == (COUNT, 4, 4)
    off_mm = np.linalg.norm(holes[:, :3, 3] - expected[:, :3, 3], axis=1)
    turned = Rotation.from_matrix(np.swapaxes(expected[:, :3, :3], 1, 2) @ holes[:, :3, :3])
    assert off_mm.max() <= 1e-3
    assert turned.magnitude().max() <= 2e-5


@forms
def test_a_correction_moves_every_hole_by_it_and_nothing_else(form: Form, tmp_path: Path) -> None:
    """The error of each hole, with the digits that every form has, is subtracted exactly."""
    texts = correctable(form, station(COUNT, 8.0))
    before = form.parse(texts)
    for suffix, text in texts.items():
        (tmp_path / f"S1100{suffix}").write_text(text, "latin-1", newline="")
    read = load_program(tmp_path / f"S1100{next(iter(texts))}")
    assert isinstance(read, Program)
    error_mm = np.round(np.random.default_rng(7).normal(0.0, 0.6, (COUNT, 3)), 3)
    positions = read.values()[:, :3].copy()
    off_mm, at = KDTree(positions).query(before.holes[:, :3, 3])
    assert np.max(off_mm) <= 1e-3
    positions[at] -= error_mm
    corrected = texts_of(read.with_positions(positions))
    after = form.parse(corrected)
    moved_mm = after.holes[:, :3, 3] - before.holes[:, :3, 3]
    np.testing.assert_allclose(moved_mm, -error_mm, atol=1e-9)
    np.testing.assert_array_equal(after.holes[:, :3, :3], before.holes[:, :3, :3])
    np.testing.assert_array_equal(after.base, before.base)
    for suffix, text in corrected.items():
        assert without_numbers(text) == without_numbers(texts[suffix])


def without_numbers(text: str) -> str:
    return re.sub(r"[\d.]+", "#", re.sub(r"[-+ ]", "", text))


def test_a_zero_has_no_sign() -> None:
    assert [fixed(each, 4) for each in (-1e-9, -0.0, -0.00006)] == ["0.0000", "0.0000", "-0.0001"]
