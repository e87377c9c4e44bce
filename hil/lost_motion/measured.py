"""The result of `hil lost-motion`: figures, sentences, plain values and report, for every face."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from hil.axis.axis_file import AxisConfig
from hil.axis.identity import measured_now
from hil.axis.lost_motion import LostMotionConfig
from hil.figures.iso230 import MEASURED_AT_A_REVERSAL, OTHER_REVERSAL_FIGURES
from hil.records.rows import Records
from hil.ui.report.markup import definitions, header, page, text
from hil.ui.report.measured_result import MeasuredResult

if TYPE_CHECKING:  # what measures and fits loads slowly
    from hil.correction.compensation import Compensation
    from hil.lost_motion.procedure import LostMotionResult
    from hil.lost_motion.published import BesidePublished


@dataclass(frozen=True, repr=False)
class ReversalResult(MeasuredResult):
    """Lost motion after a reversal. how: [lost_motion] as used; present: the compensation in force before, None for none.

    stored: whether the correction was put into force
    """

    axis: AxisConfig
    how: LostMotionConfig
    raw: LostMotionResult
    present: Compensation | None
    stored: bool = False

    @property
    def amount_um(self) -> float:
        """The lost motion."""
        return self.raw.estimate.amount_um

    @property
    def shape(self) -> str:
        """Name of the fitted curve."""
        return self.raw.estimate.rise.shape.name

    @property
    def before_um(self) -> float:
        """Largest error of the moves of the proof without the correction, µm."""
        return float(abs(self.raw.proof.before_um).max())

    @property
    def after_um(self) -> float:
        """The same with the correction in force."""
        return float(abs(self.raw.proof.after_um).max())

    @property
    def good(self) -> bool:
        """Whether the improvement is proven, or none is needed."""
        return self.raw.good or self.raw.needless

    @property
    def records(self) -> Records:
        """Of the strokes."""
        return self.raw.records

    @property
    def sentence(self) -> str:
        """The amount, its shape, and the proof."""
        proof = f"{self.before_um:.2f} → {self.after_um:.2f} µm at worst"
        kept = "stored" if self.stored else "not stored"
        return f"lost motion of {self.axis.name}: {self.amount_um:.2f} µm as {self.shape}, {proof}, {kept}"

    @cached_property
    def published(self) -> BesidePublished:
        """The document's form beside the running one, along the moves of the proof."""
        from hil.lost_motion.published import beside_published  # noqa: PLC0415  (loads slowly)

        return beside_published(self.raw.estimate, self.raw.proof.after.target_mm.tolist())

    @property
    def verdict(self) -> tuple[str, ...]:
        """Sentences on what is wrong with the result; empty for a good one."""
        from hil.lost_motion.procedure import verdict  # noqa: PLC0415  (loads slowly)

        return tuple(verdict(self.raw))

    def facts(self) -> dict[str, str]:
        """The result in a few lines, as label -> text."""
        from hil.figures.error_figures import rms  # noqa: PLC0415
        from hil.lost_motion.estimate import NOT_SEPARATELY_DETERMINED, separately_determined  # noqa: PLC0415  (loads slowly)
        from hil.lost_motion.procedure import COVERAGE  # noqa: PLC0415

        found, proof, present = self.raw.estimate, self.raw.proof, self.present
        parameters = {name.replace("_", " "): str(each) for name, each in found.determined.items()}
        parameters |= {} if separately_determined(found.parameters) else {"single amounts": NOT_SEPARATELY_DETERMINED}
        before = (
            "nothing" if present is None else "the tables" if present.rise is None else "the tables and an earlier rise"
        )
        return {
            "lost motion": f"{found.amount_um:.2f} µm, rising as {found.rise.shape.name}",
            **({"shape": found.choice, "published form": self.published.sentence} if found.contenders else {}),
            **{f"  {name}": each + (" (k = 2)" if "±" in each else "") for name, each in parameters.items()},
            "noise of a reading": f"{self.raw.stretch.noise_um:.3f} µm",
            "proof, before": f"{rms(proof.before_um):.2f} µm RMS, {self.before_um:.2f} at worst, with {before} in force",
            "proof, after": f"{rms(proof.after_um):.2f} µm RMS, {self.after_um:.2f} at worst",
            "gain": f"{proof.improvement_um.value:.3f} ± {COVERAGE * proof.improvement_um.std:.3f} µm RMS (k = 2)",
            "over-compensated": f"{proof.over_um:.2f} µm at worst,"
            f" {100.0 * proof.over_um / found.amount_um:.1f} % of the lost motion",
            "stored": str(self.axis.tables_path) if self.stored else "nothing",
            "rows": str(self.campaign),
            "what it is": f"{MEASURED_AT_A_REVERSAL['lost_motion']} ({OTHER_REVERSAL_FIGURES})",
        }

    def identity(self) -> dict[str, str]:
        """What was measured, and how, as label -> text."""
        how = self.how
        return {
            **measured_now(self.axis),
            "Strokes": f"{how.stroke_mm:g} mm around {how.at_mm:g} mm, {how.runs} to and fro,"
            f" {how.places} places after each turning",
            "Proof": f"{how.proof_moves} moves of all lengths there, before and after",
        }

    def form(self) -> dict[str, Any]:
        """As `hil lost-motion --json`."""
        from hil.figures.error_figures import rms  # noqa: PLC0415  (loads slowly)

        raw, proof = self.raw, self.raw.proof
        return {
            "axis": self.axis.name,
            "good": raw.good,
            "stored": self.stored,
            "needless": raw.needless,
            **raw.estimate.to_json(),
            "noise_um": raw.stretch.noise_um,
            "reversals": [
                {"direction": one.direction, "travel_mm": one.travel_mm.tolist(), "error_um": one.error_um.tolist()}
                for one in raw.estimate.reversals
            ],
            "proof": {
                "moves": self.how.proof_moves,
                "before": {"rms_um": rms(proof.before_um), "peak_um": self.before_um},
                "after": {"rms_um": rms(proof.after_um), "peak_um": self.after_um},
                "over_compensation_um": proof.over_um,
                "improvement_um": {"value": proof.improvement_um.value, "std": proof.improvement_um.std},
            },
            "published_form": self.published.to_json(),
            "verdict": list(self.verdict),
        }

    def _page(self) -> str:
        from hil.lost_motion.report import FOOTER, sections, tiles  # noqa: PLC0415  (plots are slow to import)

        title, identity = f"Lost motion of axis {self.axis.name} after a reversal", self.identity()
        parts = [
            header(title, identity["Measured"]),
            tiles(self.raw),
            *(f'<p class="callout">{text(sentence)}</p>' for sentence in self.verdict),
            "<h2>Identity</h2>" + definitions(identity),
            *sections(self.raw, self.published),
            "<h2>Result</h2>" + definitions({label.strip(): each for label, each in self.facts().items()}),
            FOOTER,
        ]
        return page(title, parts)
