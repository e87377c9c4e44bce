"""Tables remember the drive's parameters: what would take a reversal out twice is refused, and a changed drive is noticed."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import bench_axis
from support.backlash_axis import FACES, PARAMETERS, QUICK
from support.sim_process import SimProcess

from drivers.clock import WallClock
from drivers.errors import LinkLostError, StateError
from hil.app.main import main
from hil.axis.axis_file import AxisConfig, load_axis
from hil.backlash import job as backlash
from hil.correction.sealed import check
from hil.correction.store import SealedStore, bound_tables
from hil.correction.tables import DirectionalTable, TableMode, TableSet
from hil.machine.wiring import connected_drive
from hil.parameters.set_file import ParameterSet, SetEntry, write_set
from hil.records.journal import RowJournal
from hil.records.made_with import MadeWith, read_made_with, write_made_with
from sim_backends.bench import BenchParameters
from sim_backends.canopen_drive import EDS
from sim_backends.modbus_drive import tcp_server
from sim_backends.modbus_vendor import VendorRegisters

pytestmark = pytest.mark.usefixtures("passwords")

READING, KEY = bench_axis.PASSWORDS["HIL_PASSWORD"], bench_axis.PASSWORDS["HIL_KEY_PASSWORD"]
NAMES = {"canopen": ("2201h:00", "6091h:01"), "modbus-tcp": ("backlash", "gear_numerator")}
"""Addresses of the amount and of the gear in parameter sets."""


def lay_out(directory: Path, face: str = "canopen", machine: str = "geometric") -> Path:
    """A short axis with an instrument and the drive's own backlash compensation."""
    path = bench_axis.lay_out(directory, machine=machine)
    text = path.read_text().replace("seed = 5\n", f"seed = 5\n{FACES[face]}")
    text += f"\n[backlash]\nreference_plus_mm = 5.0\nreference_minus_mm = 5.0\n{PARAMETERS[face]}{QUICK}"
    path.write_text(text.replace("dwell_s = 0.3\nreading_s = 0.3", "dwell_s = 0.1\nreading_s = 0.1"))
    return path


def turn_knob(monkeypatch: pytest.MonkeyPatch, *, amount: int = 0, gear: int = 1) -> None:
    """The drives of benches to come hold this backlash amount, and this gear over itself."""
    objects, init = BenchParameters.objects.fget, VendorRegisters.__init__
    assert objects is not None
    own = {(0x2201, 0): amount, (0x6091, 1): gear, (0x6091, 2): gear}
    monkeypatch.setattr(BenchParameters, "objects", property(lambda bench: {**objects(bench), **own}))

    def vendor(face: VendorRegisters, *args: object, settings: dict[str, int], **more: object) -> None:
        init(face, *args, settings={**settings, "gear_numerator": gear, "gear_denominator": gear}, **more)  # type: ignore[arg-type]
        face._working["backlash"] = amount

    monkeypatch.setattr(VendorRegisters, "__init__", vendor)


def store(axis: AxisConfig, reversal_um: float, made_with: MadeWith | None) -> None:
    """Tables with this reversal everywhere; made_with: of the last measurement, None for none."""
    if made_with is not None:
        write_made_with(axis.made_with_path, made_with)
    zero = TableSet.zero([20.0, 260.0]).pitch.position_mm
    pitch = DirectionalTable(zero, [0.0, 1.0], [-reversal_um, 1.0 - reversal_um])
    SealedStore.of(axis, READING, KEY).save_tables(TableSet(TableMode.BIDIRECTIONAL, pitch))


@pytest.mark.parametrize("face", ["canopen", pytest.param("modbus-tcp", marks=pytest.mark.outside)])
def test_a_calibration_is_bound_to_the_drives_parameters_and_a_changed_drive_is_noticed(
    face: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path, (amount, gear) = lay_out(tmp_path, face), NAMES[face]
    axis = load_axis(path)
    assert main(["calibrate", str(path)]) == 0
    binding = check(axis.tables_path.read_bytes(), SealedStore.of(axis, READING).builder_public).binding
    assert binding is not None
    stated = binding.of["axes"]["X"]
    assert stated["corrects_reversal"] is True
    assert stated["made_with"]["backlash"][amount] == 0
    assert stated["made_with"]["units"][gear] == 1
    assert main(["verify", str(path)]) == 0
    assert capsys.readouterr().err == ""

    for knob, words in (({"amount": 5300}, f"{amount} was 0, is 5300"), ({"gear": 2}, f"{gear} was 1, is 2")):
        rows = sorted(axis.store.directory.rglob("*.csv"))
        with monkeypatch.context() as changed:
            turn_knob(changed, **knob)
            assert main(["verify", str(path)]) == 2
            (line,) = capsys.readouterr().err.splitlines()
            assert "the drive no longer has the parameters that its tables were made with" in line
            assert words in line
            assert sorted(axis.store.directory.rglob("*.csv")) == rows, "a row was measured"
    turn_knob(monkeypatch, gear=2)  # a calibration says so too, and makes them anew
    assert main(["calibrate", str(path)]) == 0
    assert f"{gear} was 1, is 2" in capsys.readouterr().err
    assert main(["verify", str(path)]) == 0


def test_a_campaign_goes_on_with_the_parameters_it_was_begun_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path, append = lay_out(tmp_path), RowJournal.append

    def lost(journal: RowJournal, row: Mapping[str, float]) -> None:
        if len(journal) == 3:
            raise LinkLostError("CAN adapter unplugged")
        append(journal, row)

    with monkeypatch.context() as patch:
        patch.setattr(RowJournal, "append", lost)
        assert main(["calibrate", str(path)]) == 1
    turn_knob(monkeypatch, amount=1200)
    capsys.readouterr()
    assert main(["calibrate", str(path), "--resume"]) == 2
    error = capsys.readouterr().err
    assert "the campaign's rows were measured with (2201h:00 was 0, is 1200)" in error
    turn_knob(monkeypatch, amount=0)
    assert main(["calibrate", str(path), "--resume"]) == 0


@pytest.mark.parametrize("face", ["canopen"])
def test_a_backlash_amount_is_not_written_beside_tables_that_take_the_reversal_out(
    face: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = lay_out(tmp_path, face, "worn")
    axis = load_axis(path)
    store(axis, 12.0, MadeWith({}, {NAMES[face][0]: 0.0}))
    assert main(["backlash", str(path), "--write"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "is not written, as the tables in" in line
    assert (
        f"corrected twice; take them out of force first (hil calibrate {path} --withdraw), write, and calibrate again"
        in line
    )
    assert not list(axis.store.directory.glob("backlash-*")), "it was measured"
    neighbour = replace(SealedStore.of(axis, READING, KEY), axis="Z")
    neighbour.save_tables(TableSet.zero(np.array([0.0, 10.0])))
    monkeypatch.delenv("HIL_PASSWORD")
    assert main(["calibrate", str(path), "--withdraw", "--dry-run"]) == 0
    assert bound_tables(axis) is not None
    assert main(["calibrate", str(path), "--withdraw", "--stored"]) == 2
    assert "--stored does not go with it" in capsys.readouterr().err
    assert main(["calibrate", str(path), "--withdraw"]) == 0
    assert "keeps what other axes have" in capsys.readouterr().out
    assert main(["calibrate", str(path), "--withdraw"]) == 2
    assert "nothing is in force" in capsys.readouterr().err
    assert neighbour.stored() is not None
    assert main(["backlash", str(path), "--write"]) == 0
    monkeypatch.setenv("HIL_PASSWORD", READING)

    store(axis, 0.0, None)  # tables that leave the reversal in
    assert main(["backlash", str(path), "--write"]) == 0
    assert list(axis.store.directory.glob("backlash-[0-9]*.jsonl"))


def test_only_the_amount_that_tables_were_made_with_is_written_at_the_desk(tmp_path: Path) -> None:
    axis = load_axis(lay_out(tmp_path))
    how = backlash.backlash_config(axis)
    store(axis, 12.0, MadeWith({}, {"2201h:00": 1200.0}))
    with connected_drive(axis) as drive:
        backlash.refuse_twice(axis, how, drive, 1200.0)
        for amount in (0.0, 1199.0, None):
            with pytest.raises(
                Exception, match=r"2201h is not written, as the tables in .* correct the reversal already"
            ):
                backlash.refuse_twice(axis, how, drive, amount)


def test_tables_of_before_do_not_let_an_amount_be_written(tmp_path: Path) -> None:
    axis = load_axis(lay_out(tmp_path))
    store(axis, 0.0, None)
    ours = SealedStore.of(axis, READING, KEY)
    stated = ours.load()
    assert stated.made_with is None
    assert "does not state which parameters the drive of axis X had" in str(ours.states().warning(""))  # type: ignore[union-attr]
    from hil.correction.sealed import reseal  # noqa: PLC0415

    data = axis.tables_path.read_bytes()
    entries = {"X.tables": json.dumps(stated.tables.to_dict()).encode()}
    assert ours.builder_key is not None
    axis.tables_path.write_bytes(
        reseal(data, entries, READING, ours.builder_key, bound_to={"axes": {"X": {"zero": None}}})
    )
    with (
        connected_drive(axis) as drive,
        pytest.raises(StateError, match="do not say that they leave the reversal uncorrected"),
    ):
        backlash.refuse_twice(axis, backlash.backlash_config(axis), drive)


# -- parameter sets ------------------------------------------------------------------------------------------------------
@pytest.fixture(params=["modbus", pytest.param("canopen", marks=pytest.mark.outside)])
def on_a_wire(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[Path, str, str]]:
    """An axis file whose drive is on a wire, and the addresses of its amount and of its gear."""
    path = lay_out(tmp_path, "canopen" if request.param == "canopen" else "modbus-tcp")
    head, _, rest = path.read_text().partition("[drive]\n")
    rest = rest[rest.index("[instrument]") :].replace("[instrument]", '[instrument]\nport = "/dev/null"')
    if request.param == "canopen":
        machine = SimProcess("drive", "--interface", "slcan-pty")
        try:
            place = machine.place["drive"]
            drive = f'backend = "canopen"\ninterface = "slcan"\nchannel = "{place["channel"]}"\neds = "{EDS}"\n'
            path.write_text(f"{head}[drive]\n{drive}node_id = {place['node_id']}\nsdo_timeout_s = 2.0\n{rest}")
            yield path, "2201h:00", "6091h:01"
        finally:
            machine.end()
        return
    from sim_backends.bench import Bench, known_bench  # noqa: PLC0415

    with Bench(known_bench("geometric", 5)) as bench:
        face = VendorRegisters(bench.servo, counts_per_rev=bench.parameters.servo.counts_per_rev)
        with tcp_server({1: face}, WallClock()) as (_, port):
            drive = f'backend = "modbus"\nregister_map = "vendor_style"\nurl = "tcp://127.0.0.1:{port}"\n'
            path.write_text(f"{head}[drive]\n{drive}{rest}")
            yield path, "backlash", "gear_numerator"


def test_a_download_that_takes_the_reversal_out_twice_is_refused(
    on_a_wire: tuple[Path, str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, amount, gear = on_a_wire
    axis = load_axis(path)

    def download(address: str, value: int) -> tuple[int, str]:
        write_set(tmp_path / "set.toml", ParameterSet("set", None, (SetEntry(address, value),)))
        status = main(["params", "download", str(path), "--set", str(tmp_path / "set.toml")])
        said = capsys.readouterr()
        return status, said.out + said.err

    store(axis, 12.0, MadeWith({gear: 1.0}, {amount: 700.0}))
    status, said = download(amount, 1200)
    assert status == 1
    assert (
        "would be 1200, the stored tables of axis X were made with 700 and would take the reversal out a second" in said
    )
    assert download(amount, 700)[0] == 0, "what they were made with may be put back"
    status, said = download(gear, 2)
    assert status == 0
    assert f"{gear} " in said
    assert "were made with 1 and are refused with 2: calibrate again" in said
    store(axis, 0.0, MadeWith({}, {amount: 700.0}))
    assert download(amount, 1200)[0] == 0, "tables that leave the reversal in"


# -- the drive's own table -------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("made_with", [MadeWith({}, {"2201h:00": 0.0}), None])
def test_a_drive_table_is_not_written_into_a_drive_with_another_amount(
    made_with: MadeWith | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = lay_out(tmp_path)
    path.write_text(path.read_text().replace("seed = 5\n", 'seed = 5\ncorrection_table = "simulated_array"\n'))
    axis = load_axis(path)
    store(axis, 12.0, made_with)
    turn_knob(monkeypatch, amount=1200)
    assert main(["params", "table", "download", str(path), "--prove-by", "nothing"]) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert ("2201h:00 was 0, is 1200" in line) if made_with else ("2201h:00 = 1200 the reversal may be" in line)
    if made_with is None:
        return
    turn_knob(monkeypatch, amount=0)
    assert main(["params", "table", "download", str(path), "--prove-by", "nothing"]) == 0
    noted = json.loads((axis.store.directory / "X.drive-table.json").read_text())
    assert noted["made_with"]["backlash"] == {"2201h:00": 0.0, "2202h:00": 0.0}
    assert read_made_with(axis.made_with_path) == made_with
