import glambda
import numpy as np
from {{ name }} import {{ target }}


def test_two_contacts():
    A, d = np.array([[1.0, 0.0], [1.0, 1.0]]), np.array([-1.0, 1.0])
    qp = glambda.ContactQP(A, d, np.zeros(2), np.full(2, np.inf))
    solution = {{ target }}(accuracy=1e-9).solve(qp)
    assert glambda.judge(qp, solution.x, asked=1e-9).verdict == "verified"
