from __future__ import annotations

import numpy as np

from fakes.truth.noise import KeyedNoise


def test_a_draw_that_nobody_asks_for_counts() -> None:
    lazy, eager = KeyedNoise(1), KeyedNoise(1)
    lazy.later_normal("lands", 6)
    eager.normal("lands", 6)
    assert np.array_equal(lazy.normal("lands", 6), eager.normal("lands", 6))


def test_a_draw_is_the_same_whenever_it_is_asked_for() -> None:
    lazy, eager = KeyedNoise(1), KeyedNoise(1)
    later, wanted = lazy.later_normal("lands", 6), eager.normal("lands", 6)
    lazy.normal("lands", 6)
    assert np.array_equal(later(), wanted)
    assert np.array_equal(later(), wanted)
