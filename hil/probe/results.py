"""The results of the measurements with a touch probe: figures, plain values and reports, for the terminal and for scripts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from hil.desk.result import Result
from hil.records.rows import UM_PER_MM

if TYPE_CHECKING:  # a script's names load without what measures
    from hil.probe.machine_file import ProbeMachineConfig
    from hil.probe.procedure import BoreCentre, Correction, FeatureMeasurement, RunOutMeasurement


@dataclass(frozen=True, repr=False)
class ProbeResult(Result):
    """A result of a machine with a touch probe. config: its machine file; axis: its X axis."""

    config: ProbeMachineConfig

    @property
    def good(self) -> bool:
        """Whether it came to its end."""
        return True


@dataclass(frozen=True, repr=False)
class RunOutResult(ProbeResult):
    """The probe's run-out. refused: why it was not put into force, None if it was; history: every measurement of this machine."""

    raw: RunOutMeasurement
    refused: str | None
    history: Sequence[Mapping[str, str]] = ()

    @property
    def x_um(self) -> float:
        """Offset of the ball's centre from the spindle axis in X, at spindle angle 0."""
        return UM_PER_MM * self.raw.run_out.x_mm

    @property
    def y_um(self) -> float:
        """The same in Y."""
        return UM_PER_MM * self.raw.run_out.y_mm

    @property
    def tip_radius_mm(self) -> float:
        """The ball's effective radius."""
        return self.raw.run_out.tip_radius_mm

    @property
    def std_um(self) -> float | None:
        """Standard uncertainty of each offset, None from one turn."""
        from hil.probe.runout import run_out_std_um  # noqa: PLC0415

        return run_out_std_um(self.raw.turns, self.config.position_step_mm(self.raw.mode))

    @property
    def good(self) -> bool:
        """Whether it was put into force."""
        return self.refused is None

    @property
    def sentence(self) -> str:
        """The offsets, or why they are refused."""
        found = f"Δx {self.x_um:+.2f} µm, Δy {self.y_um:+.2f} µm, tip radius {self.tip_radius_mm:.4f} mm"
        return f"run-out of {self.config.name}: {found}{'' if self.good else f', refused: {self.refused}'}"

    def form(self) -> dict[str, Any]:
        """As `hil probe measure --json`."""
        return {
            "machine": self.config.name,
            "good": self.good,
            "refused": self.refused,
            "mode": self.raw.mode,
            "seconds": self.raw.seconds,
            "run_out": asdict(self.raw.run_out),
            "run_out_std_um": self.std_um,
            "turns": [{**asdict(turn), "closure_um": turn.closure_um} for turn in self.raw.turns],
        }

    def _page(self) -> str:
        from hil.probe.report import run_out_report  # noqa: PLC0415  (plots are slow to import)

        return run_out_report(self.config, self.raw, self.refused, self.history)


@dataclass(frozen=True, repr=False)
class ProbeCorrectionResult(ProbeResult):
    """A correction by the run-out. measured: time of the run-out."""

    raw: Correction
    measured: str

    @property
    def sentence(self) -> str:
        """By how much the axes moved."""
        x_um, y_um = (UM_PER_MM * mm for mm in self.raw.driven_mm)
        return f"{self.config.codes.name(self.raw.code)} of {self.config.name}: X {x_um:+.2f} µm, Y {y_um:+.2f} µm"

    def form(self) -> dict[str, Any]:
        """As `hil probe correct --json`; mm."""
        done = self.raw
        moved = {"driven_mm": list(done.driven_mm), "counter_mm": list(done.counter_mm)}
        return {
            "machine": self.config.name,
            "measured": self.measured,
            "code": self.config.codes.name(done.code),
            **moved,
        }


@dataclass(frozen=True, repr=False)
class BoreResult(ProbeResult):
    """The centre of a bore. measured: time of the run-out that corrected it."""

    raw: BoreCentre
    measured: str

    @property
    def centre_mm(self) -> tuple[float, float]:
        """X and Y of its centre, corrected."""
        return self.raw.centring.centre_mm

    @property
    def diameter_mm(self) -> float:
        """Its diameter."""
        return self.raw.centring.diameter_mm

    @property
    def sentence(self) -> str:
        """Centre and diameter."""
        x_mm, y_mm = self.centre_mm
        return (
            f"bore of {self.config.name}: centre X {x_mm:.4f} mm, Y {y_mm:.4f} mm, diameter {self.diameter_mm:.4f} mm"
        )

    def form(self) -> dict[str, Any]:
        """As `hil probe centre --json`; mm."""
        found = {"middle_mm": list(self.raw.centring.middle_mm), "centre_mm": list(self.centre_mm)}
        done = ProbeCorrectionResult(self.axis, None, self.config, self.raw.correction, self.measured)
        return {**done.form(), **found, "diameter_mm": self.diameter_mm}

    def _page(self) -> str:
        from hil.probe.report import centre_report  # noqa: PLC0415  (plots are slow to import)

        return centre_report(self.config, self.raw, self.measured)


@dataclass(frozen=True, repr=False)
class FeatureResult(ProbeResult):
    """A face, its angle, a boss or a reference position. measured: time of the run-out that corrected it."""

    raw: FeatureMeasurement
    measured: str

    @property
    def values(self) -> Mapping[str, float]:
        """The corrected results by name; their names end in the unit."""
        return self.raw.corrected

    @property
    def sentence(self) -> str:
        """The results."""
        return f"{self.raw.name} of {self.config.name}: " + ", ".join(f"{k} {v:.5g}" for k, v in self.values.items())

    def form(self) -> dict[str, Any]:
        """As `hil probe face --json`."""
        found = self.raw
        touches = [{"axis": one.axis, "direction": one.direction, "at_mm": list(one.at_mm)} for one in found.touches]
        return {
            "machine": self.config.name,
            "feature": found.name,
            "measured": self.measured,
            "spindle_deg": found.spindle_deg,
            "corrected": dict(found.corrected),
            "uncorrected": dict(found.uncorrected),
            "contacts": touches,
        }
