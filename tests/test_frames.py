"""Frames and rotations, against SciPy's and against the definitions of the frames."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rlgcomp import units
from rlgcomp.numerics import frames


def test_the_oblique_axes_are_orthogonal_and_equally_inclined() -> None:
    C = frames.OBLIQUE_TO_BODY
    assert np.allclose(C @ C.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(C) == pytest.approx(1.0)
    assert np.degrees(np.arccos(C[2])) == pytest.approx([54.735610] * 3, abs=1e-6)


def test_the_outer_axis_at_90_deg_lays_z_north() -> None:
    C_bn = frames.table_attitude(90.0, 0.0)
    east, north, up = np.eye(3)
    assert C_bn[:, 2] == pytest.approx(north, abs=1e-15)
    assert C_bn[:, 0] == pytest.approx(-up, abs=1e-15)
    assert C_bn[:, 1] == pytest.approx(-east, abs=1e-15)


def test_earth_rate_at_the_pole_and_the_equator() -> None:
    assert frames.earth_rate_n_rad_s(90.0) == pytest.approx([0.0, 0.0, units.EARTH_RATE_RAD_S], abs=1e-20)
    assert frames.earth_rate_n_rad_s(0.0) == pytest.approx([0.0, units.EARTH_RATE_RAD_S, 0.0], abs=1e-20)


@given(st.integers(1, 60), st.integers(0, 1000))
def test_running_product_is_scipys(n: int, seed: int) -> None:
    vectors = np.random.default_rng(seed).normal(0.0, 0.5, (n, 3))
    running = frames.matrix_of(frames.running_product(frames.quaternion_of(vectors)))
    expected = Rotation.identity()
    for k in range(n):
        expected = expected * Rotation.from_rotvec(vectors[k])
        assert np.allclose(running[k], expected.as_matrix(), atol=1e-12)


def test_table_attitude_is_the_product_of_its_rotations() -> None:
    outer, inner = np.random.default_rng(1).uniform(-400.0, 400.0, (2, 20))
    C_PN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    for theta, phi, C in zip(outer, inner, frames.table_attitude(outer, inner), strict=True):
        expected = C_PN @ Rotation.from_euler("YZ", [theta, phi], degrees=True).as_matrix()
        assert np.allclose(C, expected, atol=1e-12)
