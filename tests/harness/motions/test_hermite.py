"""A motion between accepted times: exact for cubics, and on the right side of an impact."""

from __future__ import annotations

import numpy as np

from harness.motions.hermite import hermite


def test_cubics_are_exact_and_an_impact_has_the_state_after_it() -> None:
    t = np.array([0.0, 0.3, 0.3, 0.7])
    cubic = np.array([1.0, -2.0, 0.5, 3.0])
    jump = np.array([0.0, 0.0, 5.0, 5.0])
    q = np.polyval(cubic, t) + jump * (t - 0.3)
    v = np.polyval(np.polyder(cubic), t) + jump
    wanted = np.array([0.1, 0.3, 0.5, 0.7, 0.9])
    seen = np.minimum(wanted, 0.7)
    after = 5.0 * (seen >= 0.3)
    found_q, found_v = hermite(t, q[:, None, None], v[:, None, None], wanted)
    np.testing.assert_allclose(
        found_q[:, 0, 0], np.polyval(cubic, seen) + after * (seen - 0.3), atol=1e-13
    )
    np.testing.assert_allclose(
        found_v[:, 0, 0], np.polyval(np.polyder(cubic), seen) + after, atol=1e-12
    )


def test_a_motion_that_ends_with_an_impact_ends_after_it() -> None:
    t, q, v = np.array([0.0, 1.0, 1.0]), np.zeros((3, 1, 3)), np.zeros((3, 1, 3))
    v[:, 0, 1] = 0.0, -2.0, 3.0
    found_q, found_v = hermite(t, q, v, np.array([1.0, 1.5]))
    assert not found_q.any()
    assert found_v[:, 0, 1].tolist() == [3.0, 3.0]


def test_a_motion_of_one_time_stands() -> None:
    q, v = np.full((1, 2, 3), 4.0), np.full((1, 2, 3), 5.0)
    found_q, found_v = hermite(np.array([0.0]), q, v, np.array([0.0, 0.5]))
    assert found_q.shape == found_v.shape == (2, 2, 3)
    assert (found_q == 4.0).all() and (found_v == 5.0).all()
