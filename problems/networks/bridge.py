"""Bridge rectifier: four diodes turn an alternating voltage into |v| over an inductive load."""

from problems.networks.branch import Branch
from problems.networks.network import Network
from problems.networks.sources import Sine


def bridge(
    L: float = 0.5,
    R: float = 10.0,
    amplitude: float = 100.0,
    frequency: float = 50.0,
    diode_R: float = 1e-3,
    current: float = 6.0,
    eps: float = 1e-3,
    end_time: float = 0.1,
) -> Network:
    """Bridge of four diodes with an inductive load, whose current never ceases (§6.2).

    L [H], R [Ω] of the load;  amplitude [V] and frequency [Hz] of the source, which has the
    resistance of a diode;  diode_R : of each [Ω];  current : of the load at t = 0 [A]

    Nodes 1 and 2 are the ends of the source, 3 and the ground those of the load.  The load sees
    |v|, whose mean is 2 amplitude/π; for large L its current is (2 amplitude/π)/R.
    """
    diodes = [Branch(a, b, R=diode_R, diode=True, name=name) for a, b, name in DIODES]
    source = Branch(2, 1, R=diode_R, source=Sine(amplitude, frequency), name="source")
    load = Branch(3, 0, L=L, R=R, current=current, name="load")
    return Network((source, *diodes, load), 0.01 / frequency, eps, end_time)


DIODES = ((1, 3, "D1"), (2, 3, "D2"), (0, 1, "D3"), (0, 2, "D4"))
