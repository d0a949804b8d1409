"""What is said of the clock and of the machine's pace."""

from __future__ import annotations

import time

import numpy as np

from harness.machine.calibration import calibrate, clock_facts


def test_the_clock_is_measured_by_what_it_can_tell_apart() -> None:
    facts = clock_facts()
    assert all(np.isfinite(facts)) and min(facts) >= 0
    assert facts.resolution > 0


def test_the_calibration_takes_no_longer_than_the_clock_says() -> None:
    began = time.perf_counter()
    measured = calibrate()
    assert 0 < measured <= time.perf_counter() - began
