"""Evidence of the word order of registers in the values that a drive holds. Pure.

A position of some turns and a speed that somebody uses fill the low word first. Read in the wrong order such a value is larger by
2^16: that tells the orders apart without moving anything, except for values that are 0 or the same both ways, and for very large ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from drivers.modbus.codec import Order, decode
from drivers.modbus.register_map import Register

CLEAR_RATIO = 256.0
"""How many times larger a value has to be in one order to speak for the other: the upper byte of a position or speed of 32 bits is
rarely used, and of a position spread over all 32 bits less than one in a hundred is misjudged."""


@dataclass(frozen=True)
class OrderVerdict:
    """agrees: nothing speaks against the map's orders. supported: some value speaks for them."""

    agrees: bool
    supported: bool
    detail: str


def judge_orders(found: Mapping[str, tuple[Register, tuple[int, ...]]]) -> OrderVerdict:
    """Judge the word orders of a map by registers and their words as read, by name."""
    speaks_for, against = [], []
    for name, (register, words) in found.items():
        other = replace(register.layout, word_order=_other(register.layout.word_order))
        mapped, swapped = abs(float(decode(words, register.layout))), abs(float(decode(words, other)))
        if mapped and swapped / mapped >= CLEAR_RATIO:
            speaks_for.append(f"{name} {mapped:g}")
        elif swapped and mapped / swapped >= CLEAR_RATIO:
            order = other.word_order.value
            against.append(f"{name} reads {mapped:g} (raw), and {swapped:g} with word order {order}")
    if against:
        remedy = "compare with the drive's display: hil doctor AXIS.toml --probe-order REGISTER=VALUE"
        return OrderVerdict(
            False, bool(speaks_for), f"{'; '.join(against)}: the map's word order looks wrong; {remedy}"
        )
    if speaks_for:
        return OrderVerdict(True, True, f"as the map says, by the values found: {', '.join(speaks_for)} (raw)")
    remedy = "turn the motor some turns by hand, or compare with the drive's display (--probe-order REGISTER=VALUE)"
    return OrderVerdict(
        True, False, f"no value found tells the word order, as {', '.join(found)} read alike in both; {remedy}"
    )


def _other(order: Order) -> Order:
    return Order.LITTLE if order is Order.BIG else Order.BIG
