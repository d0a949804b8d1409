"""When to refactorize, in two sentences, put together from what was measured.

1. Whether R is worth keeping at all: of how many free columns on the cheapest rule that keeps it
   costs fewer operations than a factorization at every QP without conjugate gradients.
2. If it is kept: the rule with the least of the largest regrets, what to do by it, and how the
   printed rule fares in its two readings.

Rules that are fitted to a recording are no advice: they are known afterwards.
"""

from __future__ import annotations

from collections.abc import Sequence

from harness.criterion.measurement import Measurement
from reports.parts.sentences import join
from reports.parts.table import percent

DO = {
    "paper": "at once, in place of the iteration of a direction that would exceed √(2 C_QR/C_IT)",
    "paper deferred": (
        "at the next QP when a direction took more than √(2 C_QR/C_IT) iterations, and finish this "
        "one with the old R"
    ),
    "online": (
        "at the next QP when the last one cost more than the average since the last "
        "factorization, that factorization included"
    ),
}
"""What a rule that can be followed says."""
NO_R = "exact QR"


def advice(measured: Sequence[Measurement]) -> list[str]:
    """Two sentences that a reader can act on."""
    return [_whether(measured), _when(measured)]


def keeps(one: Measurement, column: str = "flops") -> bool:
    """Whether the cheapest rule of `DO` costs less than a factorization at every QP."""
    return min(one.regret(rule, column) for rule in DO) < one.regret(NO_R, column)


def _whether(measured: Sequence[Measurement]) -> str:
    without = [one for one in measured if not keeps(one)]
    kept = [one for one in measured if keeps(one)]
    said = []
    if without:
        said.append(
            f"factorize at every QP and keep no R on {_sizes(without)}: that costs "
            f"{_saving(without)} fewer operations than the cheapest rule that keeps one"
        )
    if kept:
        said.append(f"keep R on {_sizes(kept)}, where it saves {_saving(kept)} of them")
    text = "; ".join(said)
    return f"{text[:1].upper()}{text[1:]}."


def _when(measured: Sequence[Measurement]) -> str:
    worst = {rule: max(one.regret(rule) for one in measured) for rule in DO}
    order = sorted(worst, key=worst.__getitem__)
    others = [f"{_printed(rule)} up to {_signed(worst[rule])}" for rule in order[1:]]
    return (
        f"Where R is kept, factorize {DO[order[0]]}: that is at worst {_signed(worst[order[0]])} "
        f"above the best fixed interval, which is known afterwards only; {join(others)}."
    )


def _printed(rule: str) -> str:
    names = {"paper": "the printed rule at once", "paper deferred": "the printed rule deferred"}
    return names.get(rule, f"the {rule} rule")


def _sizes(measured: Sequence[Measurement]) -> str:
    """The scenes, and how many free columns they have."""
    free = [one.criterion.free for one in measured]
    low, high = f"{min(free):.0f}", f"{max(free):.0f}"
    columns = f"{low} free columns" if low == high else f"{low} to {high} free columns"
    return f"{join([one.scene for one in measured])} ({columns})"


def _saving(measured: Sequence[Measurement]) -> str:
    """By which share of the dearer of the two the cheaper is cheaper, from … to."""
    shares = []
    for one in measured:
        pair = one.rules[NO_R].cost, min(one.rules[rule].cost for rule in DO)
        shares.append(1.0 - min(pair) / max(pair))
    low, high = percent(min(shares)), percent(max(shares))
    return high if low == high else f"{low} to {high}"


def _signed(value: float) -> str:
    return f"{'+' if value >= 0 else '−'}{percent(abs(value))}"
