"""`hil calibrate`: measure an axis, compute its tables, prove them, store them sealed, revise until inside the band."""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping
from typing import Any

from drivers.errors import InputError
from drivers.files import replace_file
from hil.axis.axis_file import AxisConfig, accuracy_of, load_axis
from hil.calibration.calibrate import Calibration
from hil.calibration.job import (
    Verification,
    calibration_plan,
    enter_backlash,
    manual_tables,
    run_calibration,
    run_dense_pass,
    run_proof,
    summarise,
    verification_plan,
)
from hil.calibration.spacing import dense_steps
from hil.correction.compensation import Compensation
from hil.correction.manual import read_backlash, read_straightness
from hil.correction.store import SealedStore, bound_tables
from hil.correction.tables import DirectionalTable, SingleTable, TableSet
from hil.desk.plan import measuring_plan, with_moves_of
from hil.figures.verdict import Accuracy, At
from hil.ui.terminal.axis_options import open_store, print_plan, tell_zero
from hil.ui.terminal.measuring_options import limited, machine_of, recording_name
from hil.ui.terminal.options import KEY
from hil.ui.terminal.output import write_json
from hil.ui.terminal.passwords import password
from hil.ui.terminal.progress import terminal_progress
from hil.ui.terminal.summary import print_accuracy, print_stages


def run(args: argparse.Namespace) -> int:
    """Returns 0: inside the band (or without a band); 1: some sections outside. Raises what `calibrate` and connecting
    raise.
    """
    axis = limited(load_axis(args.axis), args.limit)
    if args.withdraw:
        return _withdraw(args, axis)
    straightness = None if args.straightness is None else read_straightness(args.straightness)
    backlash = None if args.backlash is None else read_backlash(args.backlash)
    if args.manual is not None:
        return _store_manual(args, axis, straightness, backlash)
    if args.stored:
        return _enter_backlash(args, axis, backlash)
    if args.dry_run:
        _print_dry_run(args, axis)
        return 0
    store = None if args.replay else open_store(args, axis, writing=True)
    with machine_of(args, axis) as machine, terminal_progress() as listener:
        tell_zero(args, machine)
        dense = run_dense_pass(machine, listener, resume=args.resume) if args.dense else None
        if dense is not None:
            print("\n".join(dense.proposal.sentences()))
        resume = args.resume if dense is None else dense.going_on
        proofs: list[Verification] = []

        def prove(result: Calibration) -> None:
            if store is not None and result.inside and not (args.record or args.without_proof):
                proofs.append(run_proof(machine, listener, resume=args.resume))

        result = run_calibration(
            machine,
            store,
            listener,
            straightness=straightness,
            backlash=backlash,
            resume=resume,
            recording=recording_name(args),
            then=prove,
        )
        if dense is not None:
            dense.campaign.finish()
        proof = proofs[0] if proofs else None
    summary = summarise(axis, result)
    found = None if proof is None else accuracy_of(axis, proof.records, corrected=True)
    _print(args, axis, result, summary, found)
    print("nothing is stored: this was a recording" if store is None else f"stored {store.path}")
    if args.report:
        from hil.calibration.report import calibration_report  # noqa: PLC0415  (plots are slow to import)

        replace_file(args.report, calibration_report(axis, result, proof).encode())
    if args.json:
        more = {"accuracy": None if found is None else found.as_json()}
        more |= {} if dense is None else {"dense": dense.proposal.as_json()}
        write_json(args.json, {**summary, **more})
    return 0 if result.inside and (found is None or found.good) else 1


def _print_dry_run(args: argparse.Namespace, axis: AxisConfig) -> None:
    plan = calibration_plan(axis)
    if not (args.without_proof or args.record or args.replay):
        plan = with_moves_of(plan, verification_plan(axis, 1))
    if args.dense:
        plan = with_moves_of(plan, measuring_plan(axis, dense_steps(axis), []))
    print_plan(axis, plan)


def _print(
    args: argparse.Namespace, axis: AxisConfig, result: Calibration, summary: Mapping[str, Any], found: Accuracy | None
) -> None:
    """The accuracy at other targets first, then the figures at the calibrated ones, and the sections outside the band."""
    if found is not None:
        print_accuracy(found)
    else:
        print(
            f"verified: not yet; the figures below prove nothing between the tables' targets (hil verify {args.axis})"
        )
    rounds = {f"with the tables, round {n}": one for n, one in enumerate(summary["rounds"], 1)}
    print_stages({"uncorrected": summary["before"], **rounds}, title=At.CALIBRATED.value)
    if result.moved_um:
        (target_mm, direction), most_um = max(result.moved_um.items(), key=lambda one: abs(one[1]))
        print(
            f"fine steps moved {len(result.moved_um)} sections, at most {most_um:+.2f} µm in all ({target_mm:g} mm"
            f" {'+' if direction > 0 else '-'}), allowed are {axis.correction.fine_total_um:g} µm (fine_total_um)"
        )
    for section in result.outside:
        print(f"outside the band: {section}")


def _store_manual(
    args: argparse.Namespace, axis: AxisConfig, straightness: DirectionalTable | None, backlash: SingleTable | None
) -> int:
    """Manual mode: stores the typed values in the form that the axis file asks for; nothing moves."""
    if args.resume or args.report or args.record or args.replay or args.stored:
        raise InputError(
            "--manual measures nothing: neither --resume, --report, --record, --replay nor --stored goes with it"
        )
    tables = manual_tables(axis, args.manual, straightness, backlash)
    if args.dry_run:
        return _print_dry_run_at_rest(axis)
    store = open_store(args, axis, writing=True)
    store.save(Compensation(tables), measured=False)
    return _tell_unproven(args, axis, store, tables)


def _print_dry_run_at_rest(axis: AxisConfig) -> int:
    print(f"axis {axis.name}: would move nothing")
    print(f"would write {axis.tables_path}")
    return 0


def _withdraw(args: argparse.Namespace, axis: AxisConfig) -> int:
    """Takes the axis's tables out of the sealed file; nothing moves, and no reading password is needed."""
    measuring = ("resume", "report", "record", "replay", "new_zero", "instrument_zeroed", "dense")
    if given := [name for name in ("manual", "straightness", "backlash", "stored", *measuring) if getattr(args, name)]:
        raise InputError(f"--withdraw measures and stores nothing: --{given[0].replace('_', '-')} does not go with it")
    if bound_tables(axis) is None:
        raise InputError("holds no tables of the axis, nothing is in force", path=axis.tables_path)
    if args.dry_run:
        print(f"axis {axis.name}: would move nothing")
        print(
            f"would take its tables, effects and lost motion out of {axis.tables_path}, what other axes have there stays"
        )
        return 0
    store = SealedStore.of(
        axis,
        "",
        password(args.key_password_file, KEY, "builder key's password", os.environ, usual=axis.store.key_password_file),
    )
    store.withdraw()
    left = (
        f"{store.path} keeps what other axes have"
        if store.path.exists()
        else f"{store.path} held nothing else and is gone"
    )
    print(f"axis {axis.name}: its tables, effects and lost motion are out of force; {left}")
    if args.json:
        write_json(args.json, {"axis": axis.name, "withdrawn": str(store.path), "others": store.path.exists()})
    return 0


def _enter_backlash(args: argparse.Namespace, axis: AxisConfig, backlash: SingleTable | None) -> int:
    """Stores a backlash beside the stored pitch; nothing moves."""
    if backlash is None:
        raise InputError("--stored goes with --backlash: what is to be entered beside the stored tables")
    if args.resume or args.report or args.record or args.replay or args.straightness:
        raise InputError(
            "--stored measures nothing, so --resume, --report, --record, --replay and --straightness cannot be given with it"
        )
    if args.dry_run:
        return _print_dry_run_at_rest(axis)
    store = open_store(args, axis, writing=True)
    return _tell_unproven(args, axis, store, enter_backlash(store, axis, backlash, alone=False).tables)


def _tell_unproven(args: argparse.Namespace, axis: AxisConfig, store: SealedStore, tables: TableSet) -> int:
    print(f"stored {store.path}: tables {tables.digest()[:16]}, not yet proven (hil verify {args.axis})")
    if args.json:
        write_json(args.json, {"axis": axis.name, "digest": tables.digest(), "tables": tables.to_dict()})
    return 0
