"""A solver for glambda.  Replace `run` by your own, and what prepares it."""

from dataclasses import dataclass

import numpy as np
from glambda import Answer, Solver, Status


@dataclass(frozen=True)
class {{ target }}(Solver):
    """Projected gradients with a fixed step."""

    name = "{{ name }}"
    warm_start = "x"

    def build(self, qp, start):
        x = np.zeros(qp.k) if start is None else start.x
        return qp.dense_A, qp.d, qp.lower, qp.upper, x

    def setup(self, problem, asked, start):
        A, d, lower, upper, x = problem
        length = 1.0 / max(np.linalg.norm(A.T @ A), 1e-300)
        return A, d, lower, upper, x, length, 1e-9 if asked is None else asked

    def run(self, native):
        A, d, lower, upper, x, length, asked = native
        x = np.clip(x, lower, upper)
        for count in range(1, 100_001):
            new = np.clip(x - length * (A.T @ (A @ x + d)), lower, upper)
            moved, x = np.linalg.norm(A @ (new - x)), new
            if moved <= 1e-3 * asked:
                return x, count, True
        return x, count, False

    def read(self, qp, native, result):
        x, count, done = result
        return Answer(x, Status.SOLVED if done else Status.ITERATION_LIMIT, count)
