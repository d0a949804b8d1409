"""Boost converter: a switch and a diode raise a direct voltage."""

from problems.networks.branch import Branch
from problems.networks.network import Network
from problems.networks.sources import Constant, Pulses


def boost(
    voltage: float = 12.0,
    duty: float = 0.5,
    frequency: float = 20e3,
    L: float = 1e-3,
    L_R: float = 0.01,
    C: float = 20e-6,
    load: float = 20.0,
    device_R: float = 0.01,
    current: float = 0.0,
    output: float = 0.0,
    eps: float = 1e-3,
    end_time: float = 6e-3,
) -> Network:
    """Boost converter: its output is voltage/(1 − duty) in continuous conduction (§6.2).

    voltage [V] of the source;  duty : share of a period in which the switch is closed;
    frequency : of the switch [Hz];  L [H] with the resistance L_R [Ω];  C [F];  load [Ω];
    device_R : resistance of the diode, and of the closed switch [Ω];
    current [A], output [V] : of L and C at t = 0

    Node 1 is where inductance, switch and diode meet, 2 the output.
    """
    branches = (
        Branch(0, 1, L=L, R=L_R, source=Constant(voltage), current=current, name="L"),
        Branch(1, 0, R=device_R, switch=Pulses(1 / frequency, duty), name="switch"),
        Branch(1, 2, R=device_R, diode=True, name="D"),
        Branch(2, 0, C=C, voltage=output, name="C"),
        Branch(2, 0, R=load, name="load"),
    )
    return Network(branches, 0.05 / frequency, eps, end_time)
