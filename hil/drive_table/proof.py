"""Proof that a drive's table corrects as the bridge does: the same positions with one and with the other, never with
both.

Measured by the instrument in the order bridge, drive, drive, bridge, so that a linear drift affects both alike. Or,
where the drive reports its present correction, by that value; this is quick and needs no instrument, but does not show
a wrong sign in the map.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass

import numpy as np
import scipy

from drivers.correction_table import CorrectionTable
from drivers.errors import BridgeError, CapabilityError
from hil.correction.compensation import Compensation
from hil.correction.tables import DirectionalTable
from hil.drive_table import TOLERANCE_UM
from hil.drive_table.change import held_table
from hil.drive_table.curve import DriveCurve
from hil.machine.events import Event, Listener, silent
from hil.machine.measure import bidirectional_steps, measure
from hil.machine.one_correction import switch_table
from hil.machine.session import AxisSession
from hil.machine.supervisor import Supervisor
from hil.records.journal import Campaign
from hil.records.rows import UM_PER_MM, Floats, Records

_ORDER = ("bridge-1", "drive-1", "drive-2", "bridge-2")
_SETTLE_S = 0.1  # after a motion, before a drive is asked what it adds


@dataclass(frozen=True)
class PositionDifference:
    """One position in one direction. difference_um: the drive's result minus the bridge's; bridge_um: the bridge's
    correction there.
    """

    target_mm: float
    direction: int
    difference_um: float
    bridge_um: float


@dataclass(frozen=True)
class TableProof:
    """Agreement of the two corrections. u95_um: of each difference, so that all hold together with 95 % (Bonferroni).

    measured: by the instrument, else by the value the drive reports
    """

    places: tuple[PositionDifference, ...]
    u95_um: float
    tolerance_um: float
    measured: bool

    @property
    def worst(self) -> PositionDifference:
        return max(self.places, key=lambda place: abs(place.difference_um))

    @property
    def mean_um(self) -> float:
        return float(np.mean([place.difference_um for place in self.places]))

    @property
    def share(self) -> float:
        """The drive's correction as a share of the bridge's, over all positions; NaN where the bridge's is 0."""
        bridge = np.array([place.bridge_um for place in self.places])
        added = bridge + np.array([place.difference_um for place in self.places])
        size = float(bridge @ bridge)
        return float(added @ bridge) / size if size else math.nan

    @property
    def good(self) -> bool:
        """Every difference plus its uncertainty is within the tolerance."""
        return abs(self.worst.difference_um) + self.u95_um <= self.tolerance_um

    @property
    def verdict(self) -> str:
        """The result in one sentence."""
        worst = self.worst
        place = f"{worst.difference_um:+.3f} µm at {worst.target_mm:.3f} mm, direction {worst.direction:+d}"
        spread = f"± {self.u95_um:.3f} µm (95 %)"
        if self.good:
            return f"the drive corrects as the bridge does: at most {place}, {spread}, inside ±{self.tolerance_um:g} µm"
        if abs(worst.difference_um) - self.u95_um > self.tolerance_um:
            share = self.share
            hint = " (in force? homed?)" if abs(share) < 0.2 else " (the sign?)" if share < 0 else ""
            return (
                f"the drive does not correct as the bridge does: {place}, {spread}, allowed ±{self.tolerance_um:g} µm; it adds"
                f" {share:.2f} times what the bridge adds{hint}"
            )
        return (
            f"not proven: {place}, {spread}, is too uncertain for ±{self.tolerance_um:g} µm; measure more runs, or allow"
            " more (tolerance_um)"
        )


# -- by the instrument -------------------------------------------------------------------------------------------------
def prove_by_instrument(
    session: AxisSession,
    campaign: Campaign,
    compensation: Compensation,
    targets_mm: Sequence[float],
    listener: Listener = silent,
    *,
    runs: int = 2,
    tolerance_um: float = TOLERANCE_UM,
) -> TableProof:
    """Measures on an entered session; afterwards the drive's switch is restored and the axis is without power.

    targets_mm: positions; runs: of each block, up and down. Raises CapabilityError for a drive without a described
    table, and what measuring raises.
    """
    table = held_table(session.drive)
    steps = bidirectional_steps(targets_mm, runs)
    blocks: dict[str, Records] = {}
    with _left_as_found(session, table):
        _hand_over(session, table, None, by_drive=False)
        session.prepare(campaign.directory, compensation)
        for name in _ORDER:
            by_drive = name.startswith("drive")
            _hand_over(session, table, None if by_drive else compensation, by_drive=by_drive)
            session.drive.enable()
            session.come_to_reference()
            blocks[name] = measure(session, campaign, name, steps, listener)
    return proof_of(blocks, tolerance_um)


def _hand_over(
    session: AxisSession, table: CorrectionTable, compensation: Compensation | None, *, by_drive: bool
) -> None:
    """Puts one or the other correction into force; the axis is disabled, since a drive's table is switched without
    power.
    """
    session.compensation = None
    session.drive.disable()
    switch_table(session.drive, table, by_drive)
    session.compensation = compensation


@contextmanager
def _left_as_found(session: AxisSession, table: CorrectionTable) -> Iterator[None]:
    was_on = table.enabled()

    def leave() -> None:
        session.compensation = None
        session.drive.disable()
        table.switch(was_on)

    try:
        yield
    except BaseException:
        with suppress(BridgeError):  # the error in progress is the one to report
            leave()
        raise
    leave()


def proof_of(blocks: dict[str, Records], tolerance_um: float) -> TableProof:
    """Differences of the means, with their uncertainty from the scatter of single runs, which includes the drift
    between blocks.
    """
    targets = np.unique(np.concatenate([np.round(block.target_mm, 6) for block in blocks.values()]))
    places: list[PositionDifference] = []
    squares, degrees, counts = 0.0, 0, math.inf
    for target in targets:
        for direction in (1, -1):
            mine, commanded = _errors(blocks, "bridge", float(target), direction)
            theirs, _ = _errors(blocks, "drive", float(target), direction)
            difference = float(theirs.mean() - mine.mean())
            places.append(PositionDifference(float(target), direction, difference, float(commanded.mean())))
            for found in (mine, theirs):
                squares += float(np.sum((found - found.mean()) ** 2))
                degrees += len(found) - 1
            counts = min(counts, 1.0 / (1.0 / len(mine) + 1.0 / len(theirs)))
    std_um = math.sqrt(squares / degrees) if degrees else math.nan
    quantile = float(scipy.special.stdtrit(degrees, 1.0 - 0.05 / (2 * len(places)))) if degrees else math.nan
    return TableProof(tuple(places), quantile * std_um / math.sqrt(counts), tolerance_um, measured=True)


def _errors(blocks: dict[str, Records], who: str, target_mm: float, direction: int) -> tuple[Floats, Floats]:
    """Measured minus target, and command minus target, at one position in the blocks of the bridge or the drive, µm."""
    errors, added = [], []
    for name, block in blocks.items():
        if name.startswith(who):
            here = (np.round(block.target_mm, 6) == target_mm) & (block.direction == direction)
            errors.append(block.error_um[here])
            added.append((block.command_mm - block.target_mm)[here] * UM_PER_MM)
    return np.concatenate(errors), np.concatenate(added)


# -- by the value the drive reports ----------------------------------------------------------------------------------------
@dataclass(frozen=True)
class ProofMotion:
    """Motion between the positions of a proof by the drive's value."""

    velocity_mm_s: float
    overrun_mm: float
    home: bool


def prove_by_drive(
    supervisor: Supervisor,
    wanted: DirectionalTable,
    targets_mm: Sequence[float],
    way: ProofMotion,
    listener: Listener = silent,
    *,
    tolerance_um: float = TOLERANCE_UM,
) -> TableProof:
    """Reads at each target the value that the drive adds. The axis is supervised and ends disabled; the drive's switch
    is restored.

    Raises CapabilityError where the drive does not report it, and what stops the axis.
    """
    drive = supervisor.axes[0].drive
    table = held_table(drive)
    if not table.description.shows_applied:
        raise CapabilityError(f"drive {drive.name} does not report what it adds: prove it by the instrument")
    curve = DriveCurve(table.description, table.read(), drive.scaling)
    was_on = table.enabled()
    places: list[PositionDifference] = []
    try:
        switch_table(drive, table, True)
        supervisor.get_ready(home=way.home)
        stops = bidirectional_targets(targets_mm, way.overrun_mm)
        for index, (place_mm, direction) in enumerate(stops, start=1):
            supervisor.move(place_mm, way.velocity_mm_s)
            listener(Event("by the drive's word", f"{place_mm:.3f} mm", index, len(stops)))
            if direction is not None:
                supervisor.watch(_SETTLE_S)
                added_um = curve.value_um(table.applied() or 0)
                bridge_um = float(wanted.at(place_mm, direction))
                places.append(PositionDifference(place_mm, direction, added_um - bridge_um, bridge_um))
    except BaseException:
        with suppress(BridgeError):  # the error in progress is the one to report
            drive.disable()
            table.switch(was_on)
        raise
    drive.disable()
    table.switch(was_on)
    return TableProof(tuple(places), curve.step_um / 2, tolerance_um, measured=False)


def bidirectional_targets(targets_mm: Sequence[float], overrun_mm: float) -> list[tuple[float, int | None]]:
    """The stops of the way, and the direction of arrival where the drive is read; None at the start of a direction."""
    up = sorted(targets_mm)
    way: list[tuple[float, int | None]] = [(up[0] - overrun_mm, None)]
    way += [(target, 1) for target in up]
    way.append((up[-1] + overrun_mm, None))
    return way + [(target, -1) for target in reversed(up)]
