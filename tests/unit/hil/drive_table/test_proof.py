"""The proof that a drive's table corrects as the bridge does, with figures that follow on paper."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.correction_table import Directions, Interpolation, Nodes, Outside, RawFormat, RawTable, TableDescription
from drivers.errors import StateError
from drivers.scaling import AxisScaling
from hil.correction.tables import DirectionalTable
from hil.drive_table.proof import (
    PositionDifference,
    ProofMotion,
    TableProof,
    bidirectional_targets,
    proof_of,
    prove_by_drive,
    prove_by_instrument,
)
from hil.records.rows import Records


def block(rows: list[tuple[int, float]], command_um: float = 0.0) -> Records:
    """Rows at 10 mm: direction and error, µm; commanded so many µm beyond the target."""
    table = np.array(rows, dtype=float)
    return Records.of(
        {
            "run": np.arange(1.0, len(rows) + 1),
            "direction": table[:, 0],
            "target_mm": np.full(len(rows), 10.0),
            "measured_mm": 10.0 + table[:, 1] / 1000.0,
            "command_mm": np.full(len(rows), 10.0 + command_um / 1000.0),
        }
    )


def test_the_drives_mean_less_the_bridges_and_its_uncertainty() -> None:
    """+: 1 and 3 µm with the bridge, 4 and 6 with the drive: 5 - 2. Squares 1+1 and 1+1, those of - are 0: s² = 4/4, of four means of
    two runs. Of a difference √(1/2 + 1/2)·s; four degrees of freedom and two places: t of 1 - 0.05/4 is 3.495 (tables of Student's t).
    """
    blocks = {
        "bridge-1": block([(1, 1.0), (-1, 2.0)], 5.0),
        "drive-1": block([(1, 4.0), (-1, 0.5)]),
        "drive-2": block([(1, 6.0), (-1, 0.5)]),
        "bridge-2": block([(1, 3.0), (-1, 2.0)], 7.0),
    }
    found = proof_of(blocks, 1.0)
    assert [(place.target_mm, place.direction) for place in found.places] == [(10.0, 1), (10.0, -1)]
    assert [place.difference_um for place in found.places] == pytest.approx([3.0, -1.5])
    assert [place.bridge_um for place in found.places] == pytest.approx([6.0, 6.0])
    assert found.u95_um == pytest.approx(3.495, abs=1e-3)
    assert (found.measured, found.tolerance_um) == (True, 1.0)
    assert found.worst.difference_um == pytest.approx(3.0)
    assert found.mean_um == pytest.approx(0.75)


def test_the_place_with_the_fewest_runs_has_the_largest_uncertainty() -> None:
    """+ once with each, - three times with each: √(1/1 + 1/1)·s for all. s² = 2·(1 + 0 + 1)/4 = 1, t as above."""
    three = [(-1, 1.0), (-1, 2.0), (-1, 3.0), (1, 0.0)]
    found = proof_of({"bridge-1": block(three), "drive-1": block(three)}, 1.0)
    assert found.u95_um == pytest.approx(3.495 * math.sqrt(2.0), abs=2e-3)
    once = [(1, 0.0), (-1, 0.0)]
    assert math.isnan(proof_of({"bridge-1": block(once), "drive-1": block(once)}, 1.0).u95_um)


def proof(*differences_um: float, bridge_um: float = 10.0, u95_um: float = 0.25) -> TableProof:
    places = tuple(PositionDifference(10.0 * k, 1, each, bridge_um) for k, each in enumerate(differences_um))
    return TableProof(places, u95_um, 1.0, measured=True)


@pytest.mark.parametrize(
    ("found", "good", "said"),
    [
        (proof(0.5, -0.75), True, "at most -0.750 µm at 10.000 mm"),  # 0.75 + 0.25 is just what is allowed
        (proof(0.5, -0.76), False, "not proven: -0.760 µm"),
        (proof(1.25), False, "not proven: +1.250 µm"),  # 1.25 - 0.25 may be inside
        (proof(1.26), False, "does not correct as the bridge does: +1.260 µm"),
        (proof(-10.0, -10.0), False, "it adds 0.00 times what the bridge adds (in force? homed?)"),
        (proof(-8.1), False, "it adds 0.19 times what the bridge adds (in force? homed?)"),
        (proof(-7.9), False, "it adds 0.21 times what the bridge adds"),
        (proof(-20.0, -20.0), False, "it adds -1.00 times what the bridge adds (the sign?)"),
    ],
)
def test_the_verdict(found: TableProof, good: bool, said: str) -> None:
    assert found.good is good
    assert said in found.verdict
    assert ("homed?" in found.verdict, "sign?" in found.verdict) == ("homed?" in said, "sign?" in said)


def test_a_share_of_nothing_is_not_known() -> None:
    assert math.isnan(proof(2.0, bridge_um=0.0).share)
    assert proof(5.0, 5.0).share == pytest.approx(1.5)


def test_the_stops_of_a_proof_by_the_drives_value() -> None:
    """From below up to each, beyond the last one, and down; the drive is read where a target is reached in a direction."""
    up, down = [(10.0, 1), (20.0, 1), (30.0, 1)], [(30.0, -1), (20.0, -1), (10.0, -1)]
    assert bidirectional_targets([30.0, 10.0, 20.0], 2.0) == [(8.0, None), *up, (32.0, None), *down]


class Stand:
    """Drive, table, supervisor and session in one, which takes notes. fails_at: the note before which it fails."""

    def __init__(self, fails_at: str = "", *, on: bool = True) -> None:
        self.notes: list[str] = []
        self.fails_at = fails_at
        self.on = on
        self.in_force: object = None
        self.name, self.corrected_outside, self.directory = "X", False, Path("campaign")
        self.scaling = AxisScaling(100_000, 10.0)
        self.correction_table = self.drive = self
        self.axes = [self]
        places, twentieths = RawFormat("counts", 1.0, -100_000, 100_000), RawFormat("um", 0.05, -1000, 1000)
        kind = (Nodes.EXPLICIT, Interpolation.LINEAR, Outside.HOLD, Directions.BOTH)
        self.description = TableDescription("table", 10, *kind, 1, places, twentieths, shows_applied=True)

    def note(self, what: str) -> None:
        if what == self.fails_at:
            self.fails_at = ""
            raise StateError(what)
        self.notes.append(what)

    def enabled(self) -> bool:
        return self.on

    def switch(self, on: bool) -> None:
        self.note(f"{'on' if on else 'off'}")
        self.on = on

    def read(self) -> RawTable:
        return RawTable((100, 60), (0, 40), (10_000, 40_000))

    def applied(self) -> int:
        return 100

    def get_ready(self, *, home: bool) -> None:
        self.note(f"ready, home {home}")

    def move(self, place_mm: float, velocity_mm_s: float) -> None:
        self.note(f"to {place_mm:g} at {velocity_mm_s:g}")

    def watch(self, seconds: float) -> None:
        assert seconds > 0.0
        self.note("settles")

    def enable(self) -> None:
        self.note("enable")

    def disable(self) -> None:
        self.note("disable")

    def prepare(self, directory: Path, compensation: object) -> None:
        self.note(f"prepare {compensation}")

    def come_to_reference(self) -> None:
        self.note("reference")

    @property
    def compensation(self) -> object:
        return self.in_force

    @compensation.setter
    def compensation(self, compensation: object) -> None:
        self.note(f"bridge {compensation}")
        self.in_force = compensation


def proven_by_drive(stand: Any) -> TableProof:
    wanted = DirectionalTable(np.array([0.0, 10.0]), np.array([4.0, 4.0]), np.array([5.5, 5.5]))
    return prove_by_drive(stand, wanted, [10.0], ProofMotion(20.0, 2.0, home=True))


@pytest.mark.parametrize("was_on", [True, False])
def test_by_the_drives_value_the_switch_is_left_as_it_was(was_on: bool) -> None:
    """The drive shows 100 raw, 5 µm: 1 more than wanted upwards, 0.5 less downwards; half a step of 0.05 µm is unsure."""
    stand = Stand(on=was_on)
    found = proven_by_drive(stand)
    moves = ["to 8 at 20", "to 10 at 20", "settles", "to 12 at 20", "to 10 at 20", "settles"]
    assert stand.notes == ["on", "ready, home True", *moves, "disable", "on" if was_on else "off"]
    assert [place.difference_um for place in found.places] == pytest.approx([1.0, -0.5])
    assert (found.u95_um, found.measured) == (pytest.approx(0.025), False)
    broken = Stand("settles", on=was_on)
    with pytest.raises(StateError, match="settles"):
        proven_by_drive(broken)
    assert broken.notes[-2:] == ["disable", "on" if was_on else "off"]
    assert broken.on is was_on


def test_by_the_instrument_each_correction_has_its_turn_alone_and_without_power(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stand: Any = Stand(on=False)
    rows = [(1, 1.0), (1, 3.0), (-1, 2.0), (-1, 2.0)]

    def measured(session: Any, campaign: Any, name: str, *_: object) -> Records:
        by_drive = name.startswith("drive")
        assert (stand.on, stand.in_force) == ((True, None) if by_drive else (False, "tables")), "one of them corrects"
        stand.note(name)
        return block(rows)

    monkeypatch.setattr("hil.drive_table.proof.measure", measured)
    assert prove_by_instrument(stand, stand, "tables", [10.0]).measured  # type: ignore[arg-type]
    to_bridge, to_drive = (
        ["bridge None", "disable", *way] for way in (["off", "bridge tables"], ["on", "bridge None"])
    )
    turns = [
        [*(to_drive if name.startswith("drive") else to_bridge), "enable", "reference", name]
        for name in ("bridge-1", "drive-1", "drive-2", "bridge-2")
    ]
    first = ["bridge None", "disable", "off", "bridge None", "prepare tables"]
    last = ["bridge None", "disable", "off"]
    assert stand.notes == [*first, *(note for turn in turns for note in turn), *last]
    broken: Any = Stand("reference", on=True)
    with pytest.raises(StateError, match="reference"):
        prove_by_instrument(broken, broken, "tables", [10.0])  # type: ignore[arg-type]
    assert broken.notes[-3:] == ["bridge None", "disable", "on"]
