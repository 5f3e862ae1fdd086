"""The grip laws: what follows from dimensions, symmetry and common sense, whatever the weights."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from retract_env.rod import grip
from retract_env.rod.flap import LENGTH_M, NUMBERS

Array = NDArray[np.float64]

PLAIN = np.array([0.05, 0.0044, 0.0044, 45_000.0, 0.45, 10_000.0, 0.001, 1.0])
NO_VEINS = (np.empty((0, 2)), np.zeros(1, np.int64), np.empty(0))
X = -0.02


def vein(x: float, modulus: float, y: float = 0.0022, half: float = 0.0008) -> tuple[Array, Any, Array]:
    corners = [(x - half, y - half), (x + half, y - half), (x + half, y + half), (x - half, y + half)]
    return np.array(corners), np.array([0, 4]), np.array([modulus])


def kept(flap: Array = PLAIN, veins: tuple[Any, ...] = NO_VEINS, x: float = X) -> Array:
    out = np.zeros(grip.GRIP)
    grip.grip(flap, *veins, x, grip.load()[0], out)
    return out


def test_the_weights_belong_to_the_features() -> None:
    laws, held = grip.load()
    assert PLAIN.shape == (NUMBERS,)
    assert laws.shape == (2, grip.SHAPE + len(grip.FEATURES))
    assert len(grip.POWER_OF_C) == len(grip.FEATURES)
    assert held.shape == (len(grip.HELD),)
    assert set(json.loads(grip.FITTED.read_text("utf-8"))) == {"normal", "strain", "held"}


def test_the_row_that_is_kept_says_the_same_as_the_features() -> None:
    laws = grip.load()[0]
    for c in (0.05, 0.3):
        for law, found in enumerate(grip.squeeze(kept(), c)):
            row = np.empty(len(grip.FEATURES))
            grip.features(PLAIN, *NO_VEINS, X, c, laws[law, : grip.SHAPE], row)
            expected = c * np.exp(row @ laws[law, grip.SHAPE :])
            if law == 0:
                expected *= PLAIN[6] / PLAIN[1]
            assert found == pytest.approx(expected, rel=1e-12)


def test_a_flap_stiffer_all_over_is_the_same_in_its_own_units() -> None:
    flap = PLAIN * np.array([1, 1, 1, 3, 1, 3, 1, 1])
    corners, offsets, moduli = vein(X, 4e5)
    assert kept(flap, (corners, offsets, 3 * moduli)) == pytest.approx(kept(veins=(corners, offsets, moduli)))


def test_a_flap_of_another_size_is_the_same_in_its_own_units() -> None:
    flap = PLAIN * np.array([2, 2, 2, 1, 1, 0.5, 2, 1])
    corners, offsets, moduli = vein(X, 4e5)
    large = kept(flap, (2 * corners, offsets, moduli), 2 * X)
    assert large == pytest.approx(kept(veins=(corners, offsets, moduli)), rel=1e-9)


def test_far_from_both_ends_a_grip_does_not_feel_left_from_right() -> None:
    veins = [vein(X + side * 0.001, 4e5) for side in (-1, 1)]
    assert kept(veins=veins[0]) == pytest.approx(kept(veins=veins[1]), rel=1e-6)


@pytest.mark.parametrize("veins", [NO_VEINS, vein(X, 4e5)])
def test_a_firmer_grip_presses_and_strains_more(veins: tuple[Any, ...]) -> None:
    found = np.array([grip.squeeze(kept(veins=veins), c) for c in np.linspace(0, 0.4, 41)])
    assert found[0].tolist() == [0, 0]
    assert (np.diff(found, axis=0) > 0).all()


def test_stiffer_tissue_between_the_jaws_presses_harder() -> None:
    forces = [grip.squeeze(kept(veins=vein(X, modulus)), 0.1)[0] for modulus in (5e4, 1e5, 2e5, 4e5)]
    assert (np.diff(forces) > 0).all()


def test_a_pushed_flap_presses_harder_and_a_bent_one_less_hard() -> None:
    row, held = kept(), grip.load()[1]
    row[grip.COMPRESSION] = 0.1
    flat = grip.bearing(row, held, 0.0, 0.0, 0.0)
    assert flat == pytest.approx(grip.squeeze(row, 0.1)[0], rel=0.02)
    assert grip.bearing(row, held, 0.0, 0.0, 0.01) > flat > grip.bearing(row, held, 0.0, 0.0, -0.01)
    assert grip.bearing(row, held, 0.02, 0.0, 0.0) == grip.bearing(row, held, 0.0, -0.02, 0.0) < flat


def test_a_longer_flap_dilutes_the_strain() -> None:
    long = PLAIN.copy()
    long[LENGTH_M] *= 1.5
    assert grip.squeeze(kept(long), 0.1)[1] < grip.squeeze(kept(), 0.1)[1]
