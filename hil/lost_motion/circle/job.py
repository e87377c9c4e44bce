"""The circle test of two axes as a job: driven uncorrected, by the stored tables alone, and with the stored lost motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hil.axis.axis_file import AxisConfig
from hil.axis.identity import drive_in_words, now_in_words
from hil.correction.compensation import Compensation
from hil.correction.store import SealedStore, compensation_in_force
from hil.desk.job import Job, Workplace
from hil.desk.plan import Move, Plan, PlannedWrite
from hil.lost_motion.circle.figures import QUADRANTS_DEG, Circle, Trace, by_standard
from hil.lost_motion.circle.procedure import APPROACH_MM_S, RUN_IN_MM, CircleRun, check_axes, drive_circle, prepare
from hil.machine.axes_wiring import connected_axes
from hil.machine.events import Event, Listener, Measured, silent
from hil.machine.machine import Machine
from hil.records.journal import Campaign

CIRCLE = "circle"
BEFORE, TABLES, AFTER = "uncorrected", "tables", "corrected"
"""Names of the circles: by the tables alone only where a rise of the lost motion is stored beside them."""
PERIOD_S = 0.004
"""Period of the set-points."""
VERDICT = "with the correction in force the bumps fell neither to half nor to the floor"

Axes = tuple[AxisConfig, AxisConfig]


@dataclass(frozen=True)
class DrivenCircle:
    """The result. runs: by name, the uncorrected one first; kept: the folder with the positions; without: names of axes that
    nothing is stored for, which drove every circle uncorrected; by_tables: of axes without a stored lost motion, which others have
    """

    axes: Axes
    circle: Circle
    runs: Mapping[str, CircleRun]
    kept: Path
    without: tuple[str, ...] = ()
    by_tables: tuple[str, ...] = ()

    @property
    def traces(self) -> dict[str, Trace]:
        return {name: each.trace for name, each in self.runs.items()}

    @property
    def good(self) -> bool:
        """With the correction the bumps fell to half or to the floor; True without a correction."""
        if AFTER not in self.runs:
            return True
        after = self.runs[AFTER].trace
        return after.bump_mean_um <= max(0.5 * self.runs[BEFORE].trace.bump_mean_um, after.floor_um)

    @property
    def fallen_percent(self) -> float | None:
        """Reduction of the mean bump; None without a corrected circle."""
        if AFTER not in self.runs:
            return None
        return 100.0 * (1.0 - self.runs[AFTER].trace.bump_mean_um / self.runs[BEFORE].trace.bump_mean_um)

    @property
    def fallen_by_tables_percent(self) -> float | None:
        """The same by the tables alone; None where that circle was not driven."""
        if TABLES not in self.runs:
            return None
        return 100.0 * (1.0 - self.runs[TABLES].trace.bump_mean_um / self.runs[BEFORE].trace.bump_mean_um)

    def label(self, name: str) -> str:
        """What was in force in a circle."""
        if name == AFTER and TABLES in self.runs:
            return "tables + lost motion"
        return {BEFORE: BEFORE, TABLES: "tables alone", AFTER: "tables"}[name]

    @property
    def comparison(self) -> str:
        """What the lost motion does beyond the tables, in a sentence; empty where it was not driven."""
        if TABLES not in self.runs:
            return ""
        before, tables, after = (self.runs[name].trace for name in (BEFORE, TABLES, AFTER))
        figures = (
            f"{before.bump_mean_um:.2f} µm uncorrected, {tables.bump_mean_um:.2f} by tables,"
            f" {after.bump_mean_um:.2f} with the lost motion"
        )
        if abs(after.bump_mean_um - tables.bump_mean_um) <= max(tables.floor_um, after.floor_um):
            return f"{figures}: the two corrections differ by less than the floor"
        tables_g_um, after_g_um = (round(by_standard(one, self.circle).paths[0].G_um, 2) for one in (tables, after))
        figures = f"{figures}; G {tables_g_um:.2f} µm by tables, {after_g_um:.2f} with the lost motion"
        better = after.bump_mean_um < tables.bump_mean_um
        if (after_g_um > tables_g_um) if better else (after_g_um < tables_g_um):
            fewer, rounder = ("with the lost motion", "by tables") if better else ("by tables", "with the lost motion")
            return f"{figures}: on this circle neither did better, the bumps are smaller {fewer}, and G is {rounder}"
        return f"{figures}: on this circle {'the lost motion' if better else 'the tables alone'} did better"

    @property
    def uncorrected(self) -> str:
        """Which axes had no correction, or no lost motion where another had one, in a sentence; empty where each had all."""
        said = []
        if self.without:
            names = " and ".join(self.without)
            said.append(
                f"axis {names} drove uncorrected throughout: no correction of it was in force (hil calibrate makes one)"
            )
        if self.by_tables:
            said.append(
                f"axis {' and '.join(self.by_tables)} drove by tables alone: no lost motion of it is stored (hil lost-motion)"
            )
        return "; ".join(said)

    @property
    def missed(self) -> int:
        """Set-points that came too late."""
        return sum(each.missed for each in self.runs.values())


def middle_of(axes: Axes) -> tuple[float, float]:
    """The middles of both axes' targets, mm: the default centre."""
    first, second = (0.5 * (min(a.measurement.targets_mm) + max(a.measurement.targets_mm)) for a in axes)
    return round(first, 3), round(second, 3)


def circle_plan(axes: Axes, circle: Circle) -> Plan:
    """The moves and writes of the test."""
    moves = [
        Move(f"circle {axis.name}", low, high, max(circle.feed_mm_s, APPROACH_MM_S))
        for axis, centre in zip(axes, circle.centre_mm, strict=True)
        for low, high in [(centre - circle.radius_mm - RUN_IN_MM, centre + circle.radius_mm + RUN_IN_MM)]
    ]
    names = ", ".join(axis.name for axis in axes)
    homes = any(axis.measurement.home for axis in axes)
    writes = (PlannedWrite("rows", str(axes[0].store.directory)),)
    return Plan(names, axes[0].drive.backend, tuple(moves), writes, homes)


def run_circle(
    machines: Sequence[Machine],
    circle: Circle,
    stored: Sequence[Compensation | None],
    listener: Listener = silent,
    *,
    period_s: float = PERIOD_S,
) -> DrivenCircle:
    """Prepares both axes and drives the circle: uncorrected, and where an axis has a stored correction, with those; where a
    rise of the lost motion is among them, in between with the tables alone, which switch at each reversal.

    Raises what `check_axes` and `drive_circle` raise.
    """
    axes: Axes = (machines[0].axis, machines[1].axis)
    wanted: dict[str, Sequence[Compensation | None]] = {BEFORE: [None, None]}
    if any(one is not None and one.rise is not None for one in stored):
        wanted[TABLES] = [None if one is None else replace(one, rise=None) for one in stored]
    wanted |= {AFTER: stored} if any(one is not None for one in stored) else {}
    sessions = [machine.session for machine in machines]
    check_axes(sessions, circle, period_s)
    campaign = Campaign.numbered(axes[0].store.directory, _purpose(axes, circle, stored), resume=False)
    prepare(sessions, stored)
    latency_s = [axis.instrument.latency_s or 0.0 for axis in axes]
    runs = {}
    for name, corrections in wanted.items():
        stage = f"circle, {name}"
        runs[name] = drive_circle(
            sessions, circle, corrections, latency_s=latency_s, stage=stage, period_s=period_s, listener=listener
        )
        campaign.write(f"{name}.csv", _csv(runs[name], axes))
        listener(Event(stage, found=Measured(name, runs[name].trace.bump_mean_um, "µm")))
    without = tuple(axis.name for axis, one in zip(axes, stored, strict=True) if one is None)
    by_tables = tuple(axis.name for axis, one in zip(axes, stored, strict=True) if one is not None and one.rise is None)
    return DrivenCircle(axes, circle, runs, campaign.directory, without, by_tables if TABLES in runs else ())


def circle_job(axes: Axes, circle: Circle, stores: Sequence[SealedStore | None]) -> Job:
    """Job at the desk of the first axis, returns a DrivenCircle. stores: of both axes, None for one that is not
    open.
    """

    def work(place: Workplace) -> DrivenCircle:
        stored = [None if store is None else store.stored() for store in stores]
        with connected_axes(axes, waiting=place.waiting) as machines:
            for machine in machines:
                place.watch(machine.axis.name, machine.session.drive, machine.session)
            return run_circle(machines, circle, stored, place.listener)

    return Job(CIRCLE, circle_plan(axes, circle), work, connects=True)


def _purpose(axes: Axes, circle: Circle, stored: Sequence[Compensation | None]) -> dict[str, Any]:
    return {
        "kind": CIRCLE,
        "axes": [axis.name for axis in axes],
        "centre_mm": list(circle.centre_mm),
        "radius_mm": circle.radius_mm,
        "feed_mm_s": circle.feed_mm_s,
        "sense": circle.sense,
        "in_force": [None if one is None else compensation_in_force(one) for one in stored],
    }


def _csv(run: CircleRun, axes: Axes) -> bytes:
    names = ",".join(f"pos_{axis.name.lower()}_mm" for axis in axes)
    rows = [f"{t:.6f},{p[0]:.7f},{p[1]:.7f}" for t, p in zip(run.time_s, run.position_mm, strict=True)]
    return ("\n".join([f"time_s,{names}", *rows]) + "\n").encode()


# -- what came of it -------------------------------------------------------------------------------------------------------
def report_html(driven: DrivenCircle) -> str:
    from hil.lost_motion.circle.report import CircleReport, render_circle  # noqa: PLC0415  (plots are slow to import)

    axes, circle = driven.axes, driven.circle
    names = (axes[0].name, axes[1].name)
    identity = {
        "Axes": " and ".join(names),
        "Drives": " and ".join(drive_in_words(axis) for axis in axes),
        "Measured": now_in_words(),
        "Circle": f"{circle.radius_mm:g} mm around {circle.centre_mm[0]:g}, {circle.centre_mm[1]:g} mm,"
        f" {'counter-' if circle.sense > 0 else ''}clockwise at {60 * circle.feed_mm_s:g} mm/min",
    }
    title, verdict = f"Circle of axes {names[0]} and {names[1]}", "" if driven.good else VERDICT
    traces = {driven.label(name): trace for name, trace in driven.traces.items()}
    said = " ".join(filter(None, (verdict, driven.comparison, driven.uncorrected)))
    return render_circle(CircleReport(title, traces, names, circle.sense, said, identity))


def form(driven: DrivenCircle) -> dict[str, Any]:
    """The machine-readable result."""
    circle = driven.circle
    return {
        "axes": [axis.name for axis in driven.axes],
        "good": driven.good,
        "radius_mm": circle.radius_mm,
        "feed_mm_min": 60.0 * circle.feed_mm_s,
        "sense": circle.sense,
        "circles": {
            name: {
                "in_force": driven.label(name),
                "bumps_um": dict(zip((f"{at:g}" for at in QUADRANTS_DEG), one.trace.bumps_um, strict=True)),
                "bump_mean_um": one.trace.bump_mean_um,
                "floor_um": one.trace.floor_um,
                "roundness_um": one.trace.roundness_um,
                "iso230_4": by_standard(one.trace, circle).as_json(),
                "missed_set_points": one.missed,
                "angle_deg": one.trace.angle_deg.tolist(),
                "deviation_um": one.trace.deviation_um.tolist(),
            }
            for name, one in driven.runs.items()
        },
        "uncorrected_axes": list(driven.without),
        "fallen_percent": driven.fallen_percent,
        "fallen_by_tables_percent": driven.fallen_by_tables_percent,
    }
