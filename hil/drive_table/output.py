"""How `hil params table` shows a drive's table, the one made for it, and a proof: for people, and as plain values."""

from __future__ import annotations

from typing import Any

from drivers.correction_table import TableDescription
from hil.app.terminal.output import number, print_table
from hil.drive_table import DriveTable
from hil.drive_table.change import Snapshot
from hil.drive_table.proof import Proof


def description_facts(found: TableDescription) -> dict[str, str]:
    """What a drive's table is like."""
    between = {"linear": "straight between nodes", "step": "the value of the node before"}[found.interpolation.value]
    return {
        "table": f"{found.name}, {found.points} points at most",
        "nodes": f"{found.nodes.value}, {between}, outside: {found.outside.value}",
        "directions": found.directions.value,
        "positions in": f"{found.position.scale:g} {found.position.unit}",
        "values in": f"{found.value.scale:g} {found.value.unit}, {'added' if found.sign > 0 else 'subtracted'}",
        "memory": "wears with every write" if found.wears else "working memory, gone without power unless stored",
    }


def found_facts(found: Snapshot) -> dict[str, str]:
    """What the drive holds now."""
    return {"holds": f"{len(found.raw.plus)} points", "corrects by it": "yes" if found.enabled else "no"}


def made_facts(made: DriveTable) -> dict[str, str]:
    """A table made for the drive, and how near it comes."""
    return {
        "points": str(len(made.raw.plus)),
        "largest correction": f"{made.largest_um:.2f} µm",
        "off the stored tables by": f"{made.deviation_um:.3f} µm at most, {made.rounding_um:.3f} µm of it by rounding",
    }


def made_form(made: DriveTable) -> dict[str, Any]:
    """The same as plain values."""
    return {
        "points": len(made.raw.plus),
        "deviation_um": made.deviation_um,
        "rounding_um": made.rounding_um,
        "largest_um": made.largest_um,
    }


def print_proof(proof: Proof | None) -> None:
    """Place by place, and the verdict."""
    if proof is None:
        print("not proven: nobody asked for it (--prove-by)")
        return
    cells = {(place.target_mm, place.direction): place.difference_um for place in proof.places}
    rows = [
        [number(target, 3), number(cells[target, 1], 3), number(cells[target, -1], 3)]
        for target in dict.fromkeys(place.target_mm for place in proof.places if place.direction > 0)
    ]
    print_table(["position, mm", "drive − bridge going +, µm", "going −, µm"], rows)
    print(f"{'measured' if proof.measured else 'by the drive’s own word'}: {proof.verdict}")


def proof_form(axis: str, proof: Proof | None) -> dict[str, Any]:
    """Axis, verdict and every place as plain values."""
    form: dict[str, Any] = {"axis": axis, "good": proof is None or proof.good, "proof": None}
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
    return form
