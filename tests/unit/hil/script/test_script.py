"""`import hil` as a script uses it: the same jobs, files and safety as the verbs, in simulated time on the bench."""

from __future__ import annotations

import inspect
import json
import pickle
import subprocess
import sys
import traceback
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import get_type_hints

import numpy as np
import pytest
from study import api_page
from support import bench_axis
from support.modbus_parameters import NEW, OLD, FortyFace, write_map
from support.probe_files import lay_out
from support.table_axis import lay_out_table_axis, store
from support.two_axes import lay_out_axes

import hil
from drivers.canopen.drive import CanOpenDrive
from drivers.clock import WallClock
from drivers.drive import DriveState
from hil.app.main import main
from hil.axis.axis_file import load_axis
from hil.records.rows import read_csv
from hil.script import names
from sim_backends.modbus_drive import tcp_server
from sim_backends.modbus_registers import Bank, Cell, Space

ROOT = Path(__file__).parents[4]
SHORT = {"targets_mm": [10.0, 60.0, 110.0], "runs": 2, "dwell_s": 0.1, "reading_s": 0.1}


@pytest.fixture
def path(passwords: None, tmp_path: Path) -> Path:
    return bench_axis.lay_out(tmp_path / "X")


def enabled(axis: hil.Axis) -> bool:
    return axis.read().state == DriveState.ENABLED.value


def test_after_homing_the_axis_stands_at_the_reference_as_it_came_from_below(path: Path) -> None:
    reference_mm = load_axis(path).measurement.reference_mm
    with hil.open(path) as axis:
        axis.home()
        axis.move_to(reference_mm)
        assert axis.read().direction == 1
        steps = [0.01 * step for step in [*range(1, 30), *range(28, -1, -1)]]
        axis.stream([reference_mm + step for step in steps], 0.01)
        axis.move_to(reference_mm)
        assert axis.read().direction == -1


def test_positions_with_motor_and_instrument_become_rows_for_the_diagnosis(path: Path, tmp_path: Path) -> None:
    with hil.open(path) as axis:
        assert not enabled(axis)
        assert axis.read().instrument_mm is None, "no datum yet"
        axis.home()
        readings = []
        for target_mm in (50.0, 100.0, 20.0):
            axis.move_to(target_mm)
            readings.append(axis.read())
        watched = list(axis.watch(0.5))
        watched.append(replace(watched[-1], instrument_mm=None))  # as where the instrument sent nothing meanwhile
        rows = hil.Rows.of(readings) + hil.Rows.of(watched, run=2)
        with pytest.raises(hil.InputError, match="no reading has a position of the instrument"):
            hil.Rows.of(watched[-1:])
        with pytest.raises(hil.InputError, match="there are no readings"):
            hil.Rows.of([])
        axis.disable()
        assert not enabled(axis)
    assert [one.motor_mm for one in readings] == pytest.approx([50.0, 100.0, 20.0], abs=1e-3)
    assert [one.direction for one in readings] == [1, 1, -1]
    assert all(0.0 < abs(one.instrument_mm - one.motor_mm) < 0.03 for one in readings if one.instrument_mm), (
        "its errors"
    )
    back = read_csv(rows.save(tmp_path / "rows.csv"))
    assert back.runs == [1, 2]
    assert list(back.direction[:3]) == [1, 1, -1]
    assert len(back) == 3 + 10, "one row each 50 ms"


def test_the_figures_are_those_of_the_verbs(path: Path, tmp_path: Path) -> None:
    other = bench_axis.lay_out(tmp_path / "by-verb")
    for verb in ("calibrate", "verify"):
        more = ["--without-proof"] if verb == "calibrate" else []
        assert main([verb, str(other), "--json", str(tmp_path / f"{verb}.json"), *more]) == 0
    by_verb = [json.loads((tmp_path / f"{verb}.json").read_text()) for verb in ("calibrate", "verify")]
    with hil.open(path) as axis:
        calibrated = axis.calibrate()
        axis.home(corrected=True)
        axis.move_to(100.0)
        assert axis.read().command_mm != 100.0
    with hil.open(path) as axis:  # the bench starts anew, as for a verb
        verified = axis.verify()
    assert calibrated.before.rms_um == by_verb[0]["before"]["rms_um"]
    assert calibrated.after.peak_um == by_verb[0]["rounds"][-1]["peak_um"]
    assert verified.figures.rms_um == by_verb[1]["rms_um"]
    assert verified.A_um == by_verb[1]["accuracy"]["A_um"]
    assert verified.good
    assert len(verified.rows) == len(read_csv(other.parent / "X-campaign/verify-001/verify.csv"))
    saved = json.loads(verified.save().read_text())
    assert saved["rms_um"] == by_verb[1]["rms_um"]
    assert "<html" in verified.report(tmp_path / "verified.html").read_text(encoding="utf-8")
    assert "A = " in repr(verified)
    assert len(repr(verified)) < 120
    assert "<svg" in verified._repr_html_()


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"runs": 0}, "runs"),
        ({"targets_mm": [10.0, 9000.0]}, "leaves the travel"),
        ({"velocity_mm_s": 1e6}, "velocity_mm_s"),
        ({"dwell_s": -1.0}, "dwell_s"),
    ],
)
def test_values_of_a_call_are_checked_as_those_of_the_file(path: Path, values: dict[str, float], words: str) -> None:
    with hil.open(path) as axis:
        with pytest.raises(hil.InputError, match=words):
            axis.verify(corrected=False, **values)  # type: ignore[arg-type]
        assert not enabled(axis)
    assert not list(path.parent.glob("X-campaign/uncorrected-*"))


def test_nothing_moves_outside_the_limits_or_without_a_zero(path: Path) -> None:
    with hil.open(path) as axis:
        with pytest.raises(hil.StateError, match="not ready to move, expected home"):
            axis.move_to(10.0)
        assert not enabled(axis)
        axis.home()
        before = axis.read().motor_mm
        for target_mm in (502.5, -2.5, 9000.0):
            with pytest.raises(hil.LimitError):
                axis.move_to(target_mm)
        with pytest.raises(hil.LimitError):
            axis.stream([before, before - 1000.0], 0.01)
        assert not enabled(axis), "stopped"
        with pytest.raises(hil.StateError, match="expected home"):
            axis.move_to(before)
        assert not enabled(axis), "a stopped axis is not enabled by a move"
        assert axis.read().motor_mm == pytest.approx(before, abs=1e-3)
    with pytest.raises(hil.StateError, match="is not open"):
        axis.read()


def test_an_axis_file_that_ends_with_the_drive_is_moved_and_read(tmp_path: Path) -> None:
    path = tmp_path / "X.toml"
    path.write_text(f'{bench_axis.AXIS}\n[drive]\nbackend = "bench"\nmachine = "geometric"\nseed = 5\n')
    with hil.open(path) as axis:
        axis.home()
        with pytest.raises(hil.InputError, match="velocity_mm_s"):
            axis.move_to(40.0)
        for target_mm in (40.0, 10.0):
            axis.move_to(target_mm, 50.0)
            assert axis.read().motor_mm == pytest.approx(target_mm, abs=1e-3)
        assert axis.read().instrument_mm is None
        assert {one.direction for one in axis.watch(0.2)} == {-1}
        with pytest.raises(hil.CapabilityError, match="no instrument"):
            axis.stream([10.0], 0.01)


def test_ctrl_c_stops_the_axis_keeps_the_rows_and_the_job_goes_on(path: Path) -> None:
    seen: list[hil.Event] = []

    def pressed(event: hil.Event) -> None:
        seen.append(event)
        if event.done == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), hil.open(path, on_event=pressed) as axis:
        axis.verify(corrected=False, **SHORT)  # type: ignore[arg-type]
    (kept,) = path.parent.glob("X-campaign/uncorrected-*/uncorrected.csv")
    first = read_csv(kept).measured_mm[:5]
    with hil.open(path) as axis:
        assert not enabled(axis)
        whole = axis.verify(corrected=False, resume=True, **SHORT)  # type: ignore[arg-type]
    assert list(whole.rows["measured_mm"][:5]) == list(first)
    assert len(whole.rows) == 2 * 2 * 2


def test_an_error_of_the_script_stops_and_disables(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stops: list[str] = []

    def telling(order: str, does: Callable[[CanOpenDrive], None]) -> None:
        monkeypatch.setattr(CanOpenDrive, does.__name__, lambda drive: (stops.append(order), does(drive)))

    def goes_wrong() -> None:
        with hil.open(path) as axis:
            axis.home()
            raise ZeroDivisionError

    telling("stop", CanOpenDrive.quick_stop)
    telling("off", CanOpenDrive.disable)
    with pytest.raises(ZeroDivisionError):
        goes_wrong()
    assert stops[:2] == ["stop", "off"]


def test_a_stream_follows_its_set_points(path: Path) -> None:
    path.write_text(path.read_text().replace('backend = "bench"', 'backend = "bench"\nface = "canopen"'))
    positions = [20.0 + 0.5 * (1.0 - np.cos(np.pi * k / 100)) for k in range(101)]
    with hil.open(path) as axis:
        axis.home()
        axis.move_to(20.0)
        rows = axis.stream(positions, 0.01)
        assert axis.read().motor_mm == pytest.approx(21.0, abs=0.01)
    assert list(rows["target_mm"]) == positions
    assert np.max(np.abs(rows["motor_mm"] - rows["target_mm"])) < 0.5


def test_the_other_jobs(path: Path, tmp_path: Path) -> None:
    with hil.open(path) as axis:
        assert [check.name for check in axis.doctor(move=False).checks][:2] == ["drive", "limits"]
        found = axis.backlash(steps=60, step_um=0.5)
        assert found.lost_motion_um == pytest.approx(6.0, abs=1.0), "the bench's lost motion"
        assert set(found.rows.columns) == {"run", "direction", "motor_mm", "torque_percent"}
        with pytest.raises(hil.CapabilityError, match="not certified"):
            found.certificate(tmp_path / "no.pdf")
        assert "<html" in found.report(tmp_path / "backlash.html").read_text(encoding="utf-8")


@pytest.mark.usefixtures("passwords")
def test_the_table_of_the_drive_is_written_proven_and_taken_out(tmp_path: Path) -> None:
    file, tables = lay_out_table_axis(tmp_path, "in process")
    store(file, tables)
    with hil.open(file.path) as axis:
        with pytest.raises(hil.InputError, match="expected by one of instrument, drive, nothing"):
            axis.drive_table.download(prove_by="laser")
        assert not axis.drive_table.download(prove_by="drive", positions=3, tolerance_um=0.001).good
        assert len(axis.drive_table.show()) == 0, "what was not proven is taken out again"
        made = axis.drive_table.download(prove_by="drive", positions=3)
        assert made.good
        assert json.loads(made.save(tmp_path / "made.json").read_text())["points"] == 11
        held = axis.drive_table.show()
        assert held["plus_um"][0] - held["minus_um"][0] == pytest.approx(12.0, abs=0.02)
        with pytest.raises(hil.InputError, match="expected by instrument or drive"):
            axis.drive_table.prove(prove_by="nothing")
        proven = axis.drive_table.prove(runs=1, positions=2)
        assert proven.good
        assert proven.proof is not None
        assert proven.proof.measured, "by the instrument"
        with pytest.raises(hil.StateError, match="correct"):
            axis.calibrate()
        axis.drive_table.remove()
        assert len(axis.drive_table.show()) == 0
        with pytest.raises(hil.CapabilityError, match="no report"):
            made.report(tmp_path / "no.html")


@pytest.mark.outside
def test_what_is_left_is_found_and_put_into_force(path: Path, tmp_path: Path) -> None:
    with hil.open(path) as axis:
        found = axis.lost_motion(runs=2, places=10, proof_moves=8, at_mm=100.0)
        assert found.amount_um == pytest.approx(6.0, abs=0.1), "the bench's"
        assert found.stored
        assert found.after_um < 0.1 * found.before_um
        assert "<html" in found.report(tmp_path / "lost.html").read_text(encoding="utf-8")
        loop = axis.close_loop(runs=3, rows=12, warm_up_s=20.0)
        assert loop.after.rms_um < 0.2 * loop.before.rms_um
        assert loop.good
        assert set(json.loads(loop.save().read_text())["stages"]) == {*loop.stages}
        assert "<html" in loop.report(tmp_path / "loop.html").read_text(encoding="utf-8")


@pytest.mark.outside
def test_a_verification_is_certified(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path.write_text(path.read_text() + bench_axis.CERTIFICATE)
    for name in bench_axis.PASSWORDS:
        monkeypatch.delenv(name)
    reading, key = bench_axis.PASSWORDS.values()
    with hil.open(path, password=reading, key_password=key) as axis:
        axis.calibrate(**SHORT)  # type: ignore[arg-type]
        proof = axis.verify(**SHORT | {"runs": 5})  # type: ignore[arg-type]
    made = proof.certificate(tmp_path / "certificate.pdf")
    assert made.read_bytes().startswith(b"%PDF")
    assert main(["check", str(made), "--builder", str(path.with_name("builder.pub"))]) == 0


def test_two_axes_move_on_one_clock(tmp_path: Path) -> None:
    x, y = lay_out_axes(tmp_path)[:2]
    with hil.open_axes(x, y) as (first, second):
        for axis, target_mm in ((first, 30.0), (second, 40.0)):
            axis.home()
            axis.move_to(target_mm)
        assert [first.read().motor_mm, second.read().motor_mm] == pytest.approx([30.0, 40.0], abs=1e-3)
        with pytest.raises(hil.CapabilityError, match="open it alone"):
            first.parameters.backup()
    with pytest.raises(hil.StateError, match="not open"):
        first.read()


class Face(FortyFace):
    """With a position, so that it can be connected."""

    def __init__(self) -> None:
        super().__init__()
        self.banks = {**self.banks, Space.INPUT_REGISTERS: Bank([Cell(0, "h", lambda: 0)], gaps_readable=False)}


@pytest.fixture
def modbus(tmp_path: Path) -> Iterator[tuple[Path, Face]]:
    face = Face()
    write_map(tmp_path)
    axis = bench_axis.AXIS.replace("1_000_000", "500")
    with tcp_server({7: face}, WallClock()) as (_, port):
        path = tmp_path / "X.toml"
        drive = f'backend = "modbus"\nregister_map = "forty.toml"\nurl = "tcp://127.0.0.1:{port}"\nunit = 7\n'
        path.write_text(f"{axis}\n[drive]\n{drive}")
        yield path, face


def test_a_parameter_is_changed_proven_kept_and_put_back(modbus: tuple[Path, Face]) -> None:
    path, face = modbus
    old, new = (entries.entries[0].raw for entries in (OLD, NEW))
    assert isinstance(new, int)
    with hil.open(path) as axis:
        parameters = axis.parameters
        backup = parameters.backup(path.with_name("before.toml"))
        assert parameters.diff(backup).good
        assert parameters.diff({"p0": new}).differing == {"p0": (old, new)}
        assert parameters.download({"p0": new}).good
        assert parameters.verify({"p0": new}).good
        assert parameters.store({"p0": new}).good
        assert (face.ram[0], face.flash[0]) == (new, new)
        refused = parameters.download({"p0": new, "p99": 1})
        assert not refused.good
        assert "p99" in refused.sentence
        for wrong in (True, new + 0.4):
            (said,) = parameters.download({"p0": wrong}).objections
            assert said == f"p0: {wrong!r} is no whole number"
        assert face.ram[0] == new
        assert parameters.restore().good
        assert face.ram[0] == old
        with pytest.raises(hil.CapabilityError, match="no instrument"):
            axis.calibrate()


def test_a_simulated_drive_keeps_its_parameters_as_long_as_it_is_open(path: Path) -> None:
    with hil.open(path) as axis:
        parameters, wanted = axis.parameters, {"6072h": 900}
        with pytest.raises(hil.InputError, match=r"in a script download\(FILE\)"):
            parameters.restore()
        was, value = parameters.diff(wanted).differing["6072h"]
        assert value == 900
        assert was is not None
        assert parameters.download(wanted).good
        assert parameters.verify(wanted).good
        assert parameters.verify({"0x6072": 900}).good
        axis.home()
        axis.move_to(20.0)
        bench = axis.bench
        assert parameters.verify(wanted).good, "moved meanwhile"
        assert axis.bench is bench
        assert axis.read().motor_mm == pytest.approx(20.0, abs=0.01), "where it was"
        stored = parameters.store(wanted)
        assert stored.good
        assert stored.audited is None
        assert "not proven" in stored.sentence
        stored = parameters.store(wanted, audit=True)
        assert stored.audited
        assert "after its restart it still holds all of it" in stored.sentence
        assert parameters.restore().good
        assert parameters.verify({"6072h": was}).good
    with hil.open(path) as axis:
        assert axis.parameters.verify({"6072h": was}).good, "as new"


def test_what_is_no_parameter_or_does_not_fit_is_said_and_not_written(path: Path) -> None:
    with hil.open(path) as axis:
        wanted = {"6072h": 900_000, "5000h": 1, "6065h": 900, "6072": 900}
        for result in (axis.parameters.diff(wanted), axis.parameters.verify(wanted), axis.parameters.download(wanted)):
            assert not result.good
            said, unknown, bare = result.objections
            assert "900000 does not fit" in said
            assert said.count("6072h:00") == 1
            assert unknown == "5000h:00: the drive's file has no such parameter"
            assert bare == "6072: the drive's file has no such parameter, expected 6072h"
        different = axis.parameters.verify({"6065h": 900})
        assert not different.good
        was, _ = different.differing["6065h"]
        assert repr(different) == f"<parameters of X: 6065h is {was}, expected 900>"


def test_what_a_script_catches_is_named_as_the_script_knows_it(path: Path) -> None:
    with hil.open(path) as axis, pytest.raises(hil.StateError) as raised:
        axis.move_to(20.0)
    assert traceback.format_exception_only(raised.value)[0].startswith("hil.StateError: axis X is ")
    assert isinstance(pickle.loads(pickle.dumps(raised.value)), hil.StateError)


def test_a_class_shows_its_source_and_the_types_of_its_parts() -> None:
    for name in names.__all__:
        one = getattr(hil, name)
        if isinstance(one, type) and not issubclass(one, Exception):
            assert f"class {name}" in inspect.getsource(one)
    for one in (hil.Procedure, hil.Result, hil.Rows, hil.AxisReading, hil.Event, hil.Move, hil.BacklashResult):
        assert get_type_hints(one)


def test_rows_become_frames_where_those_are_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    made = SimpleNamespace(DataFrame=lambda columns: {name: values.tolist() for name, values in columns.items()})
    rows = hil.Rows.from_lists(target_mm=[1.0, 2.0], motor_mm=[1.5, 2.5])
    for name, call in (("pandas", rows.to_pandas), ("polars", rows.to_polars)):
        monkeypatch.setitem(sys.modules, name, made)  # type: ignore[arg-type]
        assert call() == {"target_mm": [1.0, 2.0], "motor_mm": [1.5, 2.5]}
    assert list(rows)[1] == {"target_mm": 2.0, "motor_mm": 2.5}


SCRIPT = """
import hil
def main(path: str) -> float | None:
    with hil.open(path) as axis:
        axis.home()
        rows: list[hil.AxisReading] = []
        for place in range(10):
            axis.move_to(10.0 * place + 10.0)
            rows.append(axis.read())
        hil.Rows.of(rows).save("rows.csv")
        held, _ = axis.parameters.diff({"6072h": 900}).differing["6072h"]
        axis.parameters.download({"6072h": 900})
        if held is not None:
            axis.parameters.download({"6072h": held})
        try:
            return axis.verify(runs=2).A_um
        except hil.UnprovenError as error:
            print(error)
    return None
"""


@pytest.mark.outside
def test_a_script_is_checked_strictly_from_outside(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(SCRIPT)
    words = [sys.executable, "-m", "mypy", "--strict", "--config-file", "", "--cache-dir", str(tmp_path / "cache")]
    answer = subprocess.run([*words, "script.py"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stdout
    wrong = SCRIPT.replace("axis.read()", "axis.raed()").replace("runs=2", "runs='2'").replace("hil.Rows", "hil.Rwos")
    (tmp_path / "script.py").write_text(wrong)
    answer = subprocess.run([*words, "script.py"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert answer.stdout.count(": error:") >= 3, answer.stdout


@pytest.mark.outside
@pytest.mark.parametrize(
    ("use", "unused"),
    [
        ("pass", {"numpy", "scipy.special", "canopen", "drivers.errors"}),
        ("hil.open(path)", {"scipy.special", "matplotlib", "nicegui", "canopen", "pymodbus", "hil.machine.wiring"}),
        ("hil.open(path).__enter__().read()", {"scipy.special", "matplotlib", "nicegui", "hil.diagnosis"}),
    ],
)
def test_an_import_loads_what_is_used(path: Path, use: str, unused: set[str]) -> None:
    code = f"import sys, hil; path = sys.argv[1]; {use}; print(*sys.modules)"
    words = [sys.executable, "-c", code, str(path)]
    answer = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
    assert not set(answer.stdout.split()) & unused


def test_the_page_of_the_names_is_as_they_are() -> None:
    assert api_page.PAGE.read_text(encoding="utf-8") == api_page.text(), "python tests/study/api_page.py writes it"


# -- a probe -------------------------------------------------------------------------------------------------------
def test_the_run_out_is_measured_and_corrects_what_follows(tmp_path: Path) -> None:
    path = lay_out(tmp_path)
    probe = hil.open_probe(path)
    with pytest.raises(hil.InputError, match=r"runout\.json"):
        probe.centre()
    found = probe.measure()
    assert found.good
    assert (found.x_um, found.y_um) == pytest.approx((41.3, -12.7), abs=0.2), "the bench's"
    assert "<html" in found.report(tmp_path / "probe.html").read_text(encoding="utf-8")
    assert len(json.loads(found.save(tmp_path / "probe.json").read_text())["turns"]) == 2
    bore = probe.centre()
    assert bore.diameter_mm == pytest.approx(16.0, abs=0.001)
    assert "<html" in bore.report(tmp_path / "bore.html").read_text(encoding="utf-8")
    moved = probe.correct("M91")
    assert moved.raw.driven_mm == pytest.approx((found.x_um / 1000.0, 0.0))
    with pytest.raises(hil.CapabilityError, match="not certified"):
        moved.certificate(tmp_path / "no.pdf")
    assert main(["probe", "correct", str(path), "--code", "M91", "--json", str(tmp_path / "M91.json")]) == 0
    assert json.loads((tmp_path / "M91.json").read_text()) == moved.form(), (
        "the verb finds what the script put into force"
    )


def test_a_face_is_measured_with_the_run_out_in_force(tmp_path: Path) -> None:
    face = '[face]\naxis = "x"\ndirection = 1\nx_mm = 80.0\ny_mm = 30.0\nsearch_mm = 5.0\n'
    probe = hil.open_probe(lay_out(tmp_path, more=face))
    size_um = abs(probe.measure().x_um)
    found = probe.feature("face")
    (name,) = found.values
    assert abs(found.raw.uncorrected[name] - found.values[name]) * 1000.0 == pytest.approx(size_um, abs=1e-6)
    with pytest.raises(hil.InputError, match=r"lacks the table \[boss\]"):
        probe.feature("boss")


def test_what_is_refused_and_what_is_wrong_says_so(tmp_path: Path) -> None:
    probe = hil.open_probe(lay_out(tmp_path, block="closure_limit_um = 0.0001\n"))
    found = probe.measure()
    assert not found.good
    assert "refused" in found.sentence
    with pytest.raises(hil.InputError, match="expected one of M91, M92, M93"):
        probe.correct("M90")
    with pytest.raises(hil.InputError, match="latch or step"):
        probe.measure(mode="touch")
