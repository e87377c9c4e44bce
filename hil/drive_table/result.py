"""The result of writing or proving the table that a drive holds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hil.desk.result import Result

if TYPE_CHECKING:  # a script's names load without what measures
    from hil.drive_table.proof import TableProof
    from hil.drive_table.quantise import DriveTable


@dataclass(frozen=True, repr=False)
class DriveTableResult(Result):
    """A table that was written into the drive, or proven there. deviation_um: largest difference from the stored tables, by its
    numbers; undone: the drive has its earlier table again."""

    proof: TableProof | None
    deviation_um: float
    made: DriveTable | None = None
    undone: bool = False
    seconds: float = 0.0

    @property
    def good(self) -> bool:
        """Whether it is proven, or no proof was asked for."""
        return self.proof is None or self.proof.good

    @property
    def sentence(self) -> str:
        """The verdict of the proof."""
        verdict = "not proven: no proof was asked for" if self.proof is None else self.proof.verdict
        return f"table of drive {self.axis.name}: {verdict}{', put back as it was' if self.undone else ''}"

    def form(self) -> dict[str, Any]:
        """As `hil params table --json`."""
        form: dict[str, Any] = {"axis": self.axis.name, "good": self.good, "proof": None}
        proof, made = self.proof, self.made
        if proof is not None:
            form["proof"] = {
                "measured": proof.measured,
                "verdict": proof.verdict,
                "mean_um": proof.mean_um,
                "worst_um": proof.worst.difference_um,
                "u95_um": proof.u95_um,
                "tolerance_um": proof.tolerance_um,
                "share": proof.share,
                "places": [vars(place) for place in proof.places],
            }
        if made is None:
            return {**form, "deviation_um": self.deviation_um}
        written = {"points": len(made.raw.plus), "deviation_um": made.deviation_um, "rounding_um": made.rounding_um}
        return {**form, **written, "largest_um": made.largest_um, "seconds": self.seconds}
