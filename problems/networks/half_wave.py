"""Half-wave rectifier: a source, a diode, a resistance and an inductance in series."""

from problems.networks.branch import Branch
from problems.networks.network import Network
from problems.networks.sources import Sine


def half_wave(
    L: float = 0.05,
    R: float = 10.0,
    amplitude: float = 100.0,
    frequency: float = 50.0,
    eps: float = 1e-3,
    end_time: float = 0.1,
) -> Network:
    """Half-wave rectifier with resistance and inductance: (6.2) itself, in one branch (§6.2).

    L [H], R [Ω];  amplitude [V] and frequency [Hz] of the source

    With ω = 2π frequency, Z = √(R² + ω²L²) and tan φ = ωL/R, the diode conducts from θ = ωt = 0,

        i = (amplitude/Z) (sin(θ − φ) + sin φ exp(−θ/tan φ)),

    to the angle β in (π, 2π) where i = 0 again, and blocks to 2π.
    """
    source = Sine(amplitude, frequency)
    loop = Branch(0, 0, L=L, R=R, source=source, diode=True, name="load")
    return Network((loop,), 0.01 / frequency, eps, end_time)
