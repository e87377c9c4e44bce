"""Checks of a set of PDOs before anything is written to a drive: errors in it, and whether it fits the cycle.

Works on `PdoSpec` data, with the drive's dictionary where there is one. No bus is used.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

from drivers.canopen.pdo import PdoSpec
from drivers.canopen.wire_time import frame_bits
from drivers.cia402 import objects
from drivers.cia402.objects import Entry
from drivers.errors import InputError

RESERVED = (
    # CiA-301, 7.3.5: restricted COB-IDs, and those that the predefined connection set gives to something else
    (0x000, 0x000, "NMT"),
    (0x001, 0x07F, "reserved"),
    (0x080, 0x080, "SYNC"),
    (0x081, 0x0FF, "EMCY"),
    (0x100, 0x100, "TIME"),
    (0x101, 0x180, "reserved"),
    (0x581, 0x5FF, "SDO answers"),
    (0x601, 0x67F, "SDO requests"),
    (0x6E0, 0x6FF, "reserved"),
    (0x701, 0x77F, "NMT error control"),
    (0x780, 0x7FF, "reserved, LSS"),
)
LAST_SYNCHRONOUS = 240
MAX_ENTRIES = 8


class Severity(Enum):
    """Whether a finding prevents the set from being written."""

    ERROR = "error"  # the drive would refuse it, or behave dangerously
    WARNING = "warning"


@dataclass(frozen=True)
class PdoProblem:
    """One problem, in words that name the PDO and the object."""

    severity: Severity
    code: str
    text: str

    def __str__(self) -> str:
        return f"{self.severity.value} {self.code}: {self.text}"


@dataclass(frozen=True)
class MappableObject:
    """An object as a dictionary describes it: bits, and whether it may stand in a TPDO (be read) or RPDO (be written)."""

    bits: int
    mappable: bool
    readable: bool
    writable: bool


Dictionary = Mapping[tuple[int, int], MappableObject]


@dataclass(frozen=True)
class Cycle:
    """A SYNC cycle: period in µs, bit rate in bit/s, and usable share of the bus."""

    period_us: float
    bitrate: int
    budget: float = 0.7


@dataclass(frozen=True)
class Load:
    """Load of a cycle: share of the bus with the worst stuffing, and the shortest period that fits, µs."""

    share: float
    shortest_period_us: float


def predict(nodes: Mapping[int, Sequence[PdoSpec]], cycle: Cycle) -> Load:
    """Bus load of SYNC and all synchronous PDOs of all nodes in one cycle; PDOs sent every n-th SYNC count as if in each."""
    sizes = [0]
    for specs in nodes.values():
        sizes += [-(-spec.bits // 8) for spec in specs if spec.kind <= LAST_SYNCHRONOUS]
    shortest_us = sum(map(frame_bits, sizes)) * 1e6 / cycle.bitrate
    return Load(shortest_us / cycle.period_us, shortest_us)


def lint(
    nodes: Mapping[int, Sequence[PdoSpec]],
    *,
    dictionaries: Mapping[int, Dictionary] | None = None,
    cycle: Cycle | None = None,
) -> list[PdoProblem]:
    """All findings for the PDOs of all nodes of a bus, errors first. dictionaries: by node id, where known."""
    findings: list[PdoProblem] = []
    for node_id, specs in nodes.items():
        known = (dictionaries or {}).get(node_id)
        findings += _node(node_id, specs)
        for spec in specs:
            findings += _pdo(node_id, spec, known)
    findings += _clashes(nodes)
    if cycle is not None:
        findings += _fits(nodes, cycle)
    return sorted(findings, key=lambda finding: finding.severity is not Severity.ERROR)


def refuse_errors(findings: Iterable[PdoProblem]) -> None:
    """Raise InputError with the first error, and how many more there are."""
    errors = [finding for finding in findings if finding.severity is Severity.ERROR]
    if errors:
        more = f" (and {len(errors) - 1} more)" if len(errors) > 1 else ""
        raise InputError(f"PDO mapping: {errors[0].text}{more}")


def _error(code: str, text: str) -> PdoProblem:
    return PdoProblem(Severity.ERROR, code, text)


def _warning(code: str, text: str) -> PdoProblem:
    return PdoProblem(Severity.WARNING, code, text)


def _node(node_id: int, specs: Sequence[PdoSpec]) -> list[PdoProblem]:
    """Findings on a node's PDOs together."""
    findings = []
    received = [(spec, entry) for spec in specs if not (spec.transmit or spec.only_stops) for entry in spec.entries]
    sent = {entry for spec in specs if spec.transmit for entry in spec.entries}
    commanded = {entry for _, entry in received}
    where: dict[Entry, PdoSpec] = {}
    for spec, entry in received:
        if entry in where:
            findings.append(
                _error(
                    "mapped-twice",
                    f"node {node_id}: {entry} is mapped in {where[entry]} and in {spec}; each would overwrite the other"
                    + (", and a stale one drops the axis" if entry == objects.CONTROLWORD else ""),
                )
            )
        where[entry] = spec
    if objects.MODE in commanded and objects.MODE_DISPLAY not in sent:
        findings.append(
            _error(
                "mode-unconfirmed", f"node {node_id}: {objects.MODE} is commanded but {objects.MODE_DISPLAY} not sent"
            )
        )
    if objects.CONTROLWORD in commanded and objects.STATUSWORD not in sent:
        findings.append(
            _error(
                "state-unseen", f"node {node_id}: {objects.CONTROLWORD} is commanded but {objects.STATUSWORD} not sent"
            )
        )
    if objects.TARGET_POSITION in commanded:
        if objects.CONTROLWORD not in commanded:
            findings.append(
                _warning(
                    "no-controlword",
                    f"node {node_id}: {objects.TARGET_POSITION} is streamed without {objects.CONTROLWORD}",
                )
            )
        if objects.POSITION_ACTUAL not in sent:
            findings.append(
                _warning(
                    "no-feedback",
                    f"node {node_id}: {objects.TARGET_POSITION} is streamed without {objects.POSITION_ACTUAL}",
                )
            )
    numbers = [(spec.transmit, spec.number) for spec in specs]
    findings += [
        _error("number-twice", f"node {node_id}: {spec} is given twice")
        for position, spec in enumerate(specs)
        if (spec.transmit, spec.number) in numbers[:position]
    ]
    return findings


def _pdo(node_id: int, spec: PdoSpec, known: Dictionary | None) -> list[PdoProblem]:
    findings = []
    if not spec.entries:
        findings.append(_warning("empty", f"node {node_id}: {spec} maps nothing"))
    if len(spec.entries) > MAX_ENTRIES:
        findings.append(
            _warning("many-entries", f"node {node_id}: {spec} maps {len(spec.entries)} objects, many drives take 8")
        )
    if not 0 <= spec.cob_id <= 0x7FF:
        findings.append(_error("cob-id", f"node {node_id}: {spec} has no 11-bit COB-ID"))
    for low, high, owner in RESERVED:
        if low <= spec.cob_id <= high:
            findings.append(_error("cob-id", f"node {node_id}: {spec} takes a COB-ID that belongs to {owner}"))
    if LAST_SYNCHRONOUS < spec.kind < (252 if spec.transmit else 254) or not 0 <= spec.kind <= 255:
        findings.append(_error("kind", f"node {node_id}: {spec} has transmission type {spec.kind}, which is reserved"))
    if spec.only_stops and (spec.transmit or spec.entries != (objects.CONTROLWORD,) or spec.kind <= LAST_SYNCHRONOUS):
        findings.append(
            _error(
                "stop-pdo",
                f"node {node_id}: {spec} is to stop at once: it must map {objects.CONTROLWORD} alone, on event",
            )
        )
    if known is not None:
        findings += [
            _error("mapping", f"node {node_id}: {spec}: {entry} {problem}")
            for entry in spec.entries
            for problem in _mapping_problems(entry, spec.transmit, known)
        ]
    return findings


def _mapping_problems(entry: Entry, transmit: bool, known: Dictionary) -> list[str]:
    described = known.get((entry.index, entry.subindex))
    if described is None:
        return ["does not exist in this drive"]
    checks: tuple[tuple[Callable[[MappableObject], bool], str], ...] = (
        (lambda item: not item.mappable, "cannot be mapped"),
        (lambda item: transmit and not item.readable, "is write-only and cannot be sent"),
        (lambda item: not transmit and not item.writable, "is read-only and cannot be commanded"),
        (lambda item: item.bits != entry.bits, f"has {described.bits} bits, mapped are {entry.bits}"),
    )
    return [problem for fails, problem in checks if fails(described)]


def _clashes(nodes: Mapping[int, Sequence[PdoSpec]]) -> list[PdoProblem]:
    """Findings on COB-IDs with more than one sender."""
    findings = []
    senders: dict[int, tuple[str, bool]] = {}
    for node_id, specs in nodes.items():
        for spec in specs:
            # a TPDO is sent by the node, an RPDO by the master; the master may address several nodes with one frame
            name, by_master = f"node {node_id}'s {spec}", not spec.transmit
            if spec.cob_id in senders:
                other, other_by_master = senders[spec.cob_id]
                if not (by_master and other_by_master):
                    findings.append(_error("cob-id-clash", f"{name} has the COB-ID of {other}"))
                else:
                    findings.append(_warning("cob-id-shared", f"{name} shares its COB-ID with {other}"))
            senders.setdefault(spec.cob_id, (name, by_master))
    return findings


def _fits(nodes: Mapping[int, Sequence[PdoSpec]], cycle: Cycle) -> list[PdoProblem]:
    load = predict(nodes, cycle)
    what = f"SYNC and PDOs need {load.shortest_period_us:.0f} µs at worst of a cycle of {cycle.period_us:g} µs"
    if load.share > 1.0:
        return [_error("cycle", f"{what}: the cycle does not fit")]
    if load.share > cycle.budget:
        return [
            _error(
                "load", f"{what}: {100 * load.share:.0f} % of the bus, at most {100 * cycle.budget:.0f} % are allowed"
            )
        ]
    spare_us = cycle.period_us - load.shortest_period_us
    one_us = frame_bits(8) * 1e6 / cycle.bitrate
    if spare_us < 2 * one_us:
        return [_warning("no-room", f"{what}: no room is left for an SDO request and its answer")]
    return []
