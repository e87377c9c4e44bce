"""In which order parameters are written: what others depend on first, and limits so that they never cross.

Pure. What a drive refuses all the same, because of something nobody told us, is tried again after the rest (`transaction`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from drivers.errors import InputError


def in_order(
    addresses: Sequence[str],
    rank: Callable[[str], int],
    after: Mapping[str, Sequence[str]],
    crossing: Sequence[tuple[str, str]] = (),
) -> list[str]:
    """The addresses, by rank, else as given, each behind those it is to come after.

    crossing: (first, second) beside `after`; those that are not among the addresses do not matter. Raises InputError for a circle.
    """
    known = set(addresses)
    before: dict[str, set[str]] = {address: set(after.get(address, ())) & known for address in addresses}
    for first, second in crossing:
        if first in known and second in known:
            before[second].add(first)
    waiting = sorted(addresses, key=rank)  # stable
    ordered: list[str] = []
    placed: set[str] = set()
    while waiting:
        free = next((address for address in waiting if before[address] <= placed), None)
        if free is None:
            raise InputError(
                f"{' and '.join(waiting)} are to be written after each other, expected an order without a circle"
            )
        waiting.remove(free)
        ordered.append(free)
        placed.add(free)
    return ordered


def uncrossed(
    pairs: Sequence[tuple[str, str]], before: Mapping[str, float], wanted: Mapping[str, float]
) -> list[tuple[str, str]]:
    """(first, second) for each pair (lowest, highest) that changes, so that lowest <= highest holds at every moment.

    before, wanted: the values by address; a pair that is not wholly in both does not matter.
    """
    found = []
    for low, high in pairs:
        if all(address in values for address in (low, high) for values in (before, wanted)):
            found.append((high, low) if wanted[low] > before[high] else (low, high))
    return found
