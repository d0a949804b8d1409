"""Checks certificates of QPs in exact arithmetic, with nothing but Python's own library.

    python check_certificate.py fig4.cert [more.cert ...]

A certificate says of min 1/2 |A x + d|^2, lower <= x <= upper, what x is and which x_i are free
(0), at their lower (-1) or their upper bound (1).  With r = A x + d and g = A'r it is right if
  lower <= x <= upper;  g_i = 0 where free;  x_i = lower_i where -1, and g_i >= 0 or it is fixed;
  x_i = upper_i where 1, and g_i <= 0 or it is fixed.
Then A x is the one and only A x*.  A, d and bounds are float64 as hexadecimal floats, or inf; x is
hexadecimal integers over one denominator.  Nothing is rounded.  Exit code 1 if any is wrong.
"""

import json
import sys
from fractions import Fraction

FORMAT = "glambda certificate 1"
FOREIGN = (OSError, LookupError, TypeError, AttributeError, ValueError, ArithmeticError)


class Refused(ValueError):
    """What is wrong with a certificate."""


def bound(text, unbounded):
    """A bound, or None where there is none."""
    return None if float.fromhex(text) == float(unbounded) else Fraction(float.fromhex(text))


def check(qp):
    """Raise Refused, or another of FOREIGN, unless the certificate of one QP holds."""
    d = [Fraction(float.fromhex(text)) for text in qp["d"]]  # raises for inf and nan
    lower = [bound(text, "-inf") for text in qp["lower"]]
    upper = [bound(text, "inf") for text in qp["upper"]]
    A = [[(row, Fraction(float.fromhex(text))) for row, text in column] for column in qp["A"]]
    one, x = int(qp["denominator"], 16), [int(text, 16) for text in qp["numerators"]]
    sets = qp["working_set"]
    if not len(A) == len(lower) == len(upper) == len(x) == len(sets) or one <= 0:
        raise Refused("A, bounds, x and working set do not fit together")
    r = [one * value for value in d]  # everything times the denominator
    for column, value in zip(A, x, strict=True):
        rows = [row for row, _ in column]
        if len(set(rows)) != len(rows) or not all(type(i) is int and 0 <= i < len(d) for i in rows):
            raise Refused("a column of A has entries where there are no rows")
        for row, entry in column:
            r[row] += entry * value
    for i, (column, low, high) in enumerate(zip(A, lower, upper, strict=True)):
        if (low is not None and x[i] < low * one) or (high is not None and x[i] > high * one):
            raise Refused(f"x[{i}] is beyond its bounds")
        g = sum((entry * r[row] for row, entry in column), Fraction(0))
        if sets[i] == 0 and g != 0:
            raise Refused(f"row {i} is free and not stationary")
        if sets[i] != 0 and x[i] != one * {-1: low, 1: high}[sets[i]]:
            raise Refused(f"x[{i}] is not at the bound that it is said to be at")
        if sets[i] != 0 and low != high and g * sets[i] > 0:
            raise Refused(f"row {i} has the wrong sign at its bound")


def check_file(path):
    """Print what comes of a file; returns whether all of it holds."""
    try:
        with open(path) as file:
            content = json.load(file)
        if content["format"] != FORMAT:
            raise Refused(f"this is no {FORMAT}")
        qps, without, name = content["qps"], content["without"], content["recording"]
        if sorted([qp["number"] for qp in qps] + without) != list(range(content["count"])):
            raise Refused("QPs are missing, or there twice")
    except FOREIGN as error:
        print(f"{path}: REFUSED: {error!r}")
        return False
    wrong = 0
    for qp in qps:
        try:
            check(qp)
        except FOREIGN as error:
            wrong += 1
            print(f"{path}: QP {qp['number']}: REFUSED: {error!r}")
    told = f"{len(qps) - wrong} of {content['count']} QPs of {name!r} hold, {wrong} refused"
    print(f"{path}: {told}, {len(without)} without a certificate")
    return not wrong


if __name__ == "__main__":
    sys.exit(not all(list(map(check_file, sys.argv[1:]))))
