"""Electrical networks with ideal diodes and switches (§6.2): no bodies, the same QP."""

from problems.networks.branch import Branch
from problems.networks.network import Network
from problems.networks.sources import Constant, Pulses, Sine

__all__ = ["Branch", "Constant", "Network", "Pulses", "Sine"]
