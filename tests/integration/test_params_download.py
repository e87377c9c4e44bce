"""A set downloaded into simulated CANopen drives: what is refused, in which order it is written, and what is put back."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from support.parameter_rigs import ParameterRig, maker_eds, maker_keys, maker_set

from drivers.canopen.eds import EdsFile, load_eds
from drivers.raw_parameters import DriveIdentity
from hil.parameters.compare import compare
from hil.parameters.download import download
from hil.parameters.journal import Journal
from hil.parameters.recover import recover, set_before
from hil.parameters.report import Ending, JobReport
from hil.parameters.restart import load_defaults
from hil.parameters.set_file import ParameterSet, SetEntry
from hil.parameters.snapshot import back_up
from hil.parameters.transaction import Target
from sim_backends.canopen_faults import CanFault
from sim_backends.canopen_store import Flash
from sim_backends.faults import CanFaultKind

COUNT = 8
KEYS = maker_keys(COUNT)
NEW = maker_set(COUNT)
VALUES = [entry.raw for entry in NEW.entries]
K = CanFaultKind
Make = Callable[..., ParameterRig]


@pytest.fixture(scope="module")
def eds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return maker_eds(tmp_path_factory.mktemp("eds"), COUNT)


@pytest.fixture(scope="module")
def parsed(eds: Path) -> EdsFile:
    return load_eds(eds, 5)


@pytest.fixture
def make(eds: Path, parsed: EdsFile, tmp_path: Path) -> Iterator[Make]:
    rigs: list[ParameterRig] = []

    def build(**options: object) -> ParameterRig:
        rigs.append(ParameterRig(eds, tmp_path, **{"bitrate": None, "file": parsed, **options}))  # type: ignore[arg-type]
        return rigs[-1]

    yield build
    for rig in rigs:
        rig.stack.close()


def run(rig: ParameterRig, *sets: ParameterSet, **options: object) -> list[JobReport]:
    each = sets * len(rig.drives) if len(sets) == 1 else sets
    targets = [Target(*parts) for parts in zip(rig.drives, each, rig.journals, strict=True)]
    return download(targets, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("entry", "why"),
    [
        (SetEntry("607Ah:00", 0), "moves the axis"),
        (SetEntry("6040h:00", 6), "moves the axis"),
        (SetEntry("60FFh:00", 0), "moves the axis"),
        (SetEntry("6060h:00", 1), "moves the axis"),
        (SetEntry("1010h:01", 0x65766173), "is a command"),
        (SetEntry("1A00h:01", 0), "belongs to the PDO mapping"),
        (SetEntry("6041h:00", 0), "read only"),
        (SetEntry("5000h:00", 1), "has no such parameter"),
        (SetEntry("2210h:01", 1_000_001), "above its limit"),
        (SetEntry("2210h:01", -1), "does not fit U32"),
        (SetEntry("2210h:01", 1.5), "is no whole number"),
        (SetEntry("2210h:01", 5, 6), "value 5 and raw 6 do not agree"),
        (SetEntry("2210h:01", 5, type="I16"), "is a I16 in the set, the drive's is a U32"),
        (SetEntry("2210h:01", 5, after=("2210h:02",)), "is to come after 2210h:02, which is not in the set"),
        (SetEntry("stiffness", 5), "has no such parameter"),
    ],
)
def test_one_wrong_entry_and_nothing_is_written(make: Make, entry: SetEntry, why: str) -> None:
    rig = make()
    before = rig.values(KEYS)
    report = run(rig, replace(NEW, entries=(*NEW.entries, entry)))[0]
    assert report.ending is Ending.REFUSED
    assert any(why in str(objection) and entry.address in str(objection) for objection in report.objections)
    assert rig.values(KEYS) == before
    assert rig.journals[0].last() is None


@pytest.mark.parametrize("key", KEYS[:3])
def test_a_value_that_the_drive_holds_is_not_out_of_range(make: Make, parsed: EdsFile, key: tuple[int, int]) -> None:
    held = parsed.entries[key].default
    assert isinstance(held, int)
    narrow = {**parsed.entries, key: replace(parsed.entries[key], low=held + 1, high=held + 2)}
    rig = make(file=replace(parsed, entries=narrow))
    contents = back_up(rig.drives)[0].contents
    assert contents is not None
    address = f"{key[0]:04X}h:{key[1]:02X}"
    assert not compare([(rig.drives[0], contents)])[0].objections
    assert run(rig, contents)[0].ending is Ending.UNCHANGED
    entries = tuple(
        replace(each, value=held + 5, raw=None) if each.address == address else each for each in contents.entries
    )
    refused = run(rig, replace(contents, entries=entries))[0]
    assert [str(each) for each in refused.objections if "above its limit" in each.why]


def test_all_objections_are_named_at_once(make: Make) -> None:
    rig = make()
    rig.bench.servo.power_on()
    rig.bench.slave.dictionary.on_read(0x6041, 0, lambda: 0x1637)
    identity = DriveIdentity("canopen", {"vendor_id": 1}, {"firmware": "0.1"})
    report = run(rig, replace(NEW, identity=identity, entries=(*NEW.entries, SetEntry("5000h:00", 1))))[0]
    told = "\n".join(map(str, report.objections))
    for what in ("5000h:00", "vendor id 0x1", "firmware '0.1'", "the drive is operation enabled"):
        assert what in told
    assert report.ending is Ending.REFUSED


def test_a_set_for_this_model_goes_into_another_drive_of_it_but_not_past_its_firmware(make: Make) -> None:
    rig = make()
    identity = back_up(rig.drives)[0].contents.identity  # type: ignore[union-attr]
    assert identity is not None
    other = replace(identity, unit={"serial": 99}, version={**identity.version, "firmware": "older"})
    contents = replace(NEW, identity=other)
    assert run(rig, contents)[0].ending is Ending.REFUSED
    target = Target(rig.drives[0], contents, rig.journals[0], any_version=True)
    assert download([target])[0].ending is Ending.WRITTEN


def test_a_cable_pulled_at_one_of_three_drives(make: Make) -> None:
    """The others do not wait for it longer than for an answer, are put back, and say because of whom."""
    fault = CanFault(K.NODE_DEAD, at_s=0.0285, duration_s=20.0)
    rig = make(nodes=(3, 4, 5), faults=(fault,), only=4, bitrate=1_000_000)
    before = rig.values(KEYS)
    reports = run(rig, NEW, store=True)
    assert [report.ending for report in reports] == [Ending.PUT_BACK, Ending.UNFINISHED, Ending.PUT_BACK]
    assert reports[0].notes == ("because of X4",)
    assert [rig.values(KEYS, node) for node in (0, 2)] == [before] * 2
    assert rig.values(KEYS, 1) not in (before, VALUES)
    rig.bench.clock.sleep_s(30.0)
    assert recover(list(zip(rig.drives, rig.journals, strict=True)), forward=False)[0].good
    assert rig.values(KEYS, 1) == before


class _KeepsHalf(Flash):
    """Memory that acknowledges, and loses half of the maker's parameters at the next start; `dips` times."""

    dips = 1

    @property
    def intact(self) -> bool:
        """Asked at every start."""
        if self.image and self.dips:
            self.dips -= 1
            for key in KEYS[COUNT // 2 :]:
                self.image[key] = bytes(len(self.image[key]))
        return True


def test_a_store_without_a_restart_says_that_it_was_not_proven(make: Make) -> None:
    rig = make(flash=_KeepsHalf())
    report = run(rig, NEW, store=True)[0]
    assert report.good, "it was written and read back, and the drive confirmed the store"
    assert "as the drive says; not proven: only a restart shows" in report.kept
    assert report.as_json()["kept"] == report.kept
    assert report.as_json()["audited"] is None
    assert run(rig, NEW)[0].kept == ""


def test_a_drive_that_acknowledges_and_keeps_half_is_found_out_and_the_way_back_works(make: Make) -> None:
    rig = make(flash=Flash())
    before = rig.values(KEYS)
    assert run(rig, maker_set(COUNT, seed=9), store=True)[0].stored
    good = rig.values(KEYS)
    assert good != before
    honest = rig.bench.slave.store.flash
    rig.bench.slave.store.flash = _KeepsHalf(dict(honest.image), honest.checksum)
    report = run(rig, NEW, store=True, ask=pytest.fail)[0]
    lost = [f"{index:04X}h:{subindex:02X}" for index, subindex in KEYS[COUNT // 2 :]]
    assert (report.ending, report.stored, report.audited, list(report.lost)) == (Ending.WRITTEN, True, False, lost)
    assert not report.good
    assert "NOT kept" in report.kept
    assert "`hil params restore --store --audit` puts back" in report.kept
    assert rig.values(KEYS) not in (good, VALUES), "half new, half nothing"
    last = rig.journals[0].last_change()
    assert last is not None
    restored = run(rig, set_before(last), store=True, ask=pytest.fail)[0]
    assert restored.good
    assert "proven" in restored.kept
    assert rig.values(KEYS) == good


def test_a_drive_that_cannot_store_says_so_before_anything_is_written(make: Make) -> None:
    rig = make()
    before = rig.values(KEYS)
    rig.bench.slave.dictionary.on_read(0x1010, 1, lambda: 0)
    report = run(rig, NEW, store=True)[0]
    assert report.ending is Ending.REFUSED
    assert "does not keep its parameters on command" in str(report.objections[0])
    assert rig.values(KEYS) == before


def test_targets_are_harmless_before_a_store(make: Make) -> None:
    rig = make()
    rig.bench.slave.dictionary.set_number(0x607A, 0, 1_000_000)
    assert run(rig, NEW, store=True)[0].stored
    stored = int.from_bytes(rig.bench.slave.store.flash.image[0x607A, 0], "little", signed=True)
    assert stored == rig.bench.servo.position_actual_counts


def test_before_the_last_download_and_the_makers_defaults(make: Make) -> None:
    rig = make()
    before = rig.values(KEYS)
    run(rig, NEW, store=True)
    noted = Journal(rig.journals[0].folder).last()
    assert noted is not None
    assert run(rig, set_before(noted))[0].ending is Ending.WRITTEN
    assert rig.values(KEYS) == before
    run(rig, NEW, store=True)
    assert load_defaults(rig.drives, pytest.fail) == [""]
    assert rig.values(KEYS) == before


def test_a_backup_brings_everything_back(make: Make) -> None:
    rig = make()
    backup = back_up(rig.drives)[0].contents
    assert backup is not None
    assert not {"607Ah:00", "6040h:00", "6041h:00", "1010h:01"} & set(backup.addresses)
    run(rig, NEW)
    compared = compare([(rig.drives[0], backup)])[0]
    assert [row.address for row in compared.rows if row.side.value == "differs"] == [
        entry.address for entry in NEW.entries
    ]
    assert run(rig, backup)[0].ending is Ending.WRITTEN
    assert compare([(rig.drives[0], backup)])[0].same
