"""Engines that are exact, crash, hang or diverge, for the campaign over engines."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from harness.peers.base import Motion, Peer, Settings
from problems import Scene

STEPS = (0.02, 0.01, 0.005)


class Flying(Peer):
    """Free flight with a constant velocity: an error of g t²/2, at a made-up CPU time."""

    package = "glambda"
    settings: ClassVar[Settings] = {"stock": {}}
    model = "knows no contact"
    resolutions = STEPS
    middling = STEPS[:1]

    def __init__(self, scene: Scene, resolution: float) -> None:
        self.scene, self.h = scene, resolution

    def run(self, times: Sequence[float]) -> Motion:
        t = np.array(times)[:, None, None]
        q = self.scene.q0 + t * self.scene.v0
        return Motion(q, np.broadcast_to(self.scene.v0, q.shape), 1e-3, round(times[-1] / self.h))


class Crashing(Flying):
    """Dies at the middle step."""

    def run(self, times: Sequence[float]) -> Motion:
        if self.h == STEPS[1]:
            print("out of luck", flush=True)
            os.abort()
        return super().run(times)


class Hanging(Flying):
    """Never comes back from the middle step."""

    def run(self, times: Sequence[float]) -> Motion:
        if self.h == STEPS[1]:
            time.sleep(1000.0)
        return super().run(times)


class Diverging(Flying):
    """Ends at no number, or raises."""

    def run(self, times: Sequence[float]) -> Motion:
        if self.h == STEPS[0]:
            raise RuntimeError("no convergence")
        motion = super().run(times)
        return Motion(motion.q * np.nan, motion.v, motion.cpu, motion.steps)
