"""Proof that drive and bridge correct alike: found where they do, and not where the drive's map is wrong, on every wire."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.table_axis import FACES, lay_out_table_axis

from drivers.correction_table import RawTable
from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling
from hil.axis.axis_file import AxisConfig
from hil.correction.compensation import Compensation
from hil.correction.tables import DirectionalTable, TableSet
from hil.drive_table.change import held_table
from hil.drive_table.proof import ProofMotion, TableProof, prove_by_drive, prove_by_instrument
from hil.drive_table.quantise import drive_table, wanted_of
from hil.machine.supervisor import Supervisor
from hil.machine.watched_axis import WatchedAxis
from hil.machine.wiring import connected, connected_drive
from hil.records.journal import Campaign
from sim_backends.bare_shaft import SMALL_SERVO
from sim_backends.clock import SimClock
from sim_backends.own_table import ARRAY, TableForm, error_domain
from sim_backends.servo import SimulatedServo
from sim_backends.virtual_drive import VirtualDrive, VirtualDriveSettings

TARGETS = (47.3, 201.9)
Spoil = Callable[[RawTable], RawTable]


def right(raw: RawTable) -> RawTable:
    return raw


def measured(axis: AxisConfig, tables: TableSet, spoil: Spoil = right) -> TableProof:
    """Written as a map that is wrong in some way would have it, and proven by the laser."""
    compensation = Compensation(tables)
    with connected(axis) as machine:
        drive = machine.session.drive
        table = held_table(drive)
        made = drive_table(wanted_of(compensation), table.description, axis.scaling, axis.limits)
        table.write(spoil(made.raw))
        campaign = Campaign.numbered(axis.store.directory, {"kind": "proof"}, resume=False)
        proof = prove_by_instrument(machine.session, campaign, compensation, TARGETS, runs=1)
        assert not table.enabled()
        assert machine.session.compensation is None
    return proof


SPOILT: dict[str, Spoil] = {
    "sign": lambda raw: replace(raw, plus=tuple(-v for v in raw.plus), minus=tuple(-v for v in raw.minus)),
    "directions swapped": lambda raw: replace(raw, plus=raw.minus, minus=raw.plus),
    "a tenth of the unit": lambda raw: replace(raw, plus=tuple(v // 10 for v in raw.plus)),
    "nothing": lambda raw: replace(raw, plus=(0,) * len(raw.plus), minus=(0,) * len(raw.minus)),
    "nodes elsewhere": lambda raw: replace(raw, origin=raw.origin + 4_000_000),
}


@pytest.mark.outside
def test_drive_and_bridge_correct_alike(tmp_path: Path) -> None:
    proof = measured(*lay_out_table_axis(tmp_path, "in process"))
    assert proof.good, proof.verdict
    assert proof.u95_um < 0.1
    assert {(place.target_mm, place.direction) for place in proof.places} == {(t, d) for t in TARGETS for d in (1, -1)}
    assert abs(proof.worst.difference_um) < 0.5
    assert "the drive corrects as the bridge does" in proof.verdict


@pytest.mark.parametrize("wrong", [pytest.param(w, marks=pytest.mark.outside if w != "sign" else ()) for w in SPOILT])
def test_a_map_that_is_wrong_is_found_out(wrong: str, tmp_path: Path) -> None:
    axis, tables = lay_out_table_axis(tmp_path, "in process")
    proof = measured(axis, tables, SPOILT[wrong])
    assert not proof.good
    assert "the drive does not correct as the bridge does" in proof.verdict
    if wrong == "sign":
        for place in proof.places:
            assert place.bridge_um == pytest.approx(
                float(tables.correction_um(place.target_mm, place.direction)), abs=1e-3
            )
            assert place.difference_um == pytest.approx(-2.0 * place.bridge_um, abs=0.6)
        assert "it adds -1.00 times what the bridge adds (the sign?)" in proof.verdict
    if wrong == "directions swapped":
        assert [place.difference_um for place in proof.places] == pytest.approx([-12.0, 12.0] * 2, abs=0.6)
    if wrong == "nothing":
        assert proof.share == pytest.approx(0.0, abs=0.03)
        assert "in force? homed?" in proof.verdict


@pytest.mark.outside
@pytest.mark.parametrize("face", [face for face in FACES if face != "in process"])
def test_on_every_wire(face: str, tmp_path: Path) -> None:
    proof = measured(*lay_out_table_axis(tmp_path, face))
    assert proof.good, proof.verdict


@pytest.mark.parametrize(
    "face",
    [
        "in process",
        pytest.param("canopen, array", marks=pytest.mark.outside),
    ],
)
def test_by_the_drives_own_word(face: str, tmp_path: Path) -> None:
    axis, tables = lay_out_table_axis(tmp_path, face)
    wanted = wanted_of(Compensation(tables))
    how = ProofMotion(axis.measurement.velocity_mm_s, axis.measurement.overrun_mm, home=True)
    with connected_drive(axis) as drive:
        table = held_table(drive)
        made = drive_table(wanted, table.description, axis.scaling, axis.limits)
        table.write(made.raw)
        for raw, good in ((made.raw, True), (replace(made.raw, plus=made.raw.minus), False)):
            table.write(raw)
            with Supervisor([WatchedAxis(drive)]) as moving:
                proof = prove_by_drive(moving, wanted, TARGETS, how)
            assert proof.good is good, proof.verdict
            assert not proof.measured
            assert proof.u95_um == pytest.approx(abs(table.description.value.um(axis.scaling)) / 2.0)  # half a step
            assert not table.enabled()
    assert abs(max(place.difference_um for place in proof.places if place.direction < 0)) < 0.5


class Shaft:
    """What the motor turns, and where it stands."""

    friction_permille = 0.0
    motor_rev = 0.0

    def step(self, motor_rev: float, dt_s: float) -> None:
        self.motor_rev = motor_rev


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("form", [ARRAY, error_domain(10.0)], ids=["array", "domain"])
def test_the_load_stands_where_the_bridge_would_have_put_it(form: TableForm, direction: int) -> None:
    """A whole axis in which counts may fall as the table advances: what the shaft does, whatever anyone says of it."""
    clock, shaft = SimClock(), Shaft()
    servo = SimulatedServo(shaft, replace(SMALL_SERVO, position_window_counts=0.5))
    clock.attach(servo.advance, bearable=servo.bearable)
    scaling = AxisScaling(100_000, 10.0, direction=direction)
    limits = DriveLimits(-3.0, 300.0, 200.0, 2000.0)
    settings = VirtualDriveSettings(homing_method=37, home_position_mm=0.0)
    drive = VirtualDrive(servo, scaling, limits, clock, settings=settings, table=form)
    wanted = DirectionalTable(
        np.array([0.0, 55.0, 140.0, 290.0]), np.array([3.0, -20.0, 8.0, 31.0]), np.array([-4.0, -33.0, 1.0, 5.0])
    )
    with drive:
        table = held_table(drive)
        made = drive_table(wanted, table.description, scaling, limits)
        table.write(made.raw)
        table.switch(True)
        with Supervisor([WatchedAxis(drive)]) as axis:
            axis.get_ready(home=True)
            for place_mm, way in ((20.0, 1), (100.0, 1), (250.0, 1), (180.0, -1), (30.0, -1), (60.0, 1)):
                axis.move(place_mm, 150.0)
                axis.watch(0.2)
                load_um = direction * shaft.motor_rev * 10_000.0 - place_mm * 1000.0
                assert load_um == pytest.approx(float(wanted.at(place_mm, way)), abs=made.deviation_um + 0.2)
