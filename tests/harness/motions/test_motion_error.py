"""How far two motions are apart, in poses and in events."""

from __future__ import annotations

import numpy as np
import pytest

from harness.motions.motion_error import APART, WINDOW, Motion, match_events, pose_error
from problems.stepping.run import Event

G = 9.81


def bouncing(times: np.ndarray, speed: float = 3.0) -> Motion:
    """A ball that falls from 1 m, and is thrown up again with `speed` where it meets the ground."""
    hit = float(np.sqrt(2.0 / G))
    before, after = times[times < hit], times[times > hit]
    t = np.concatenate([before, [hit, hit], after])
    y = np.concatenate(
        [1 - G * before**2 / 2, [0.0, 0.0], speed * (after - hit) - G * (after - hit) ** 2 / 2]
    )
    v = np.concatenate([-G * before, [-G * hit, speed], speed - G * (after - hit)])
    q, rate = np.zeros((2, len(t), 1, 3))
    q[:, 0, 1], rate[:, 0, 1] = y, v
    return Motion(t, q, rate, np.array([0.5]), [Event(hit, "impulse", "")])


def still(x: float, until: float = 1.0, rest: bool = False) -> Motion:
    """Two bodies at rest at (x, 0, 0) and (2x, 0, 0)."""
    t = np.linspace(0.0, until, 11)
    q = np.zeros((11, 2, 3))
    q[:, 0, 0], q[:, 1, 0] = x, 2 * x
    events = [Event(until, "rest", "")] if rest else []
    return Motion(t, q, np.zeros_like(q), np.array([1.0, 2.0]), events)


def test_pieces_of_cubics_are_interpolated_exactly_across_an_impact() -> None:
    coarse, fine = bouncing(np.linspace(0, 1, 8)), bouncing(np.linspace(0, 1, 301))
    assert pose_error(fine, coarse).largest() < 1e-14
    assert pose_error(coarse, fine).largest() < 1e-14


def test_the_time_of_an_impact_itself_is_no_division_by_zero() -> None:
    motion = bouncing(np.linspace(0, 1, 8))
    assert motion.at(motion.t) == pytest.approx(motion.q, abs=1e-15)
    assert motion.at(np.array([2.0]))[0] == pytest.approx(motion.q[-1])


def test_an_impact_that_comes_late_shows_only_between_the_two() -> None:
    times = np.linspace(0, 0.3, 31)
    one, other = bouncing(times), bouncing(times)
    assert pose_error(one, other).error.max() == 0.0
    error = pose_error(bouncing(np.linspace(0, 1, 50), speed=3.1), bouncing(np.linspace(0, 1, 50)))
    assert error.largest(one.events[0].t) == 0.0
    assert error.largest() == pytest.approx(0.1 * (1 - one.events[0].t))


def test_a_turn_counts_by_the_size_of_the_body() -> None:
    one, other = still(0.0), still(0.0)
    other.q[:, 1, 2] = 0.01
    error = pose_error(other, one)
    assert error.largest() == pytest.approx(0.02)  # radius 2
    assert error.rms() == pytest.approx(0.02 / np.sqrt(2))  # one of two bodies


def test_when_motions_separate() -> None:
    one, other = still(0.0), still(0.0)
    assert np.isnan(pose_error(other, one).apart)
    other.q[6:, 0, 1] = 2 * APART
    error = pose_error(other, one)
    assert error.apart == pytest.approx(0.6)
    assert error.largest(0.55) == 0.0
    assert error.largest() == pytest.approx(2 * APART)


def test_what_came_to_rest_goes_on_standing_there() -> None:
    early, late = still(1.0, 1.0, rest=True), still(1.0, 2.0, rest=True)
    late.q[-1, 0, 0] += 0.5
    assert pose_error(early, late).largest() == pytest.approx(0.5)
    assert pose_error(late, early).largest() == pytest.approx(0.5)
    cut = still(1.0, 1.0)  # no rest: nothing is known beyond its end
    assert pose_error(cut, late).largest() < 1e-15
    assert pose_error(late, cut).t[-1] == pytest.approx(1.0)


def events(*pairs: tuple[float, str]) -> list[Event]:
    return [Event(t, kind, "") for t, kind in pairs]


def test_equal_sequences_match_with_their_time_errors() -> None:
    one = events((0.1, "impulse"), (0.2, "slip_to_stick"), (0.3, "impulse"))
    other = events((0.101, "impulse"), (0.198, "slip_to_stick"), (0.3, "impulse"))
    match = match_events(one, other)
    assert match[:3] == (3, 0, 0)
    assert match.largest == pytest.approx(0.002)
    assert np.isnan(match.mismatch)


def test_one_event_more_does_not_shift_the_others() -> None:
    one = events((0.1, "impulse"), (0.1005, "impulse"), (0.2, "impulse"), (0.3, "slide_off"))
    other = events((0.1, "impulse"), (0.2, "impulse"), (0.3, "slide_off"))
    match = match_events(one, other)
    assert match[:3] == (3, 0, 1)
    assert match.largest == 0.0  # not with the one at 0.1005
    assert match.mismatch == pytest.approx(0.1005)
    assert match_events(other, one)[:3] == (3, 1, 0)
    # of two candidates the nearer one, whichever comes first
    near = match_events(events((0.15, "impulse")), events((0.11, "impulse"), (0.16, "impulse")))
    assert near.largest == pytest.approx(0.01)
    near = match_events(events((0.15, "impulse")), events((0.14, "impulse"), (0.19, "impulse")))
    assert near.largest == pytest.approx(0.01)


def test_events_of_other_kinds_or_times_do_not_match() -> None:
    assert match_events(events((0.1, "impulse")), events((0.1, "slide_off")))[:3] == (0, 1, 1)
    late = events((0.1 + 1.1 * WINDOW, "impulse"))
    assert match_events(late, events((0.1, "impulse")))[:3] == (0, 1, 1)
    bookkeeping = events((0.1, "drop"), (0.1, "hand_over"), (0.2, "rest"), (0.1, "stick_to_slip"))
    assert match_events(bookkeeping, [])[:3] == (0, 0, 0)


def test_what_happens_later_does_not_count_but_for_the_partner_of_what_is_in_time() -> None:
    assert match_events(events((0.9, "impulse")), [], until=0.5)[:3] == (0, 0, 0)
    late, reference = events((0.501, "impulse")), events((0.5, "impulse"), (0.7, "impulse"))
    assert match_events(late, reference, until=0.5)[:3] == (1, 0, 0)
    assert match_events(reference, late, until=0.5)[:3] == (0, 0, 0)
