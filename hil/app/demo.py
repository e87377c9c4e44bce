"""`hil demo`: the whole loop on the built-in bench, with no hardware and no arguments."""

from __future__ import annotations

import argparse
import secrets
import shutil
import time
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from drivers.clock import NS_PER_S
from drivers.errors import InputError
from drivers.files import replace_file
from hil.axis.axis_file import AxisConfig, accuracy_of, load_axis
from hil.calibration.explore import Exploration
from hil.calibration.job import VERIFY, Verification, run_verification
from hil.correction.sealed import new_key, save_private_key, save_public_key
from hil.correction.store import SealedStore
from hil.diagnosis.loop.command import print_findings
from hil.diagnosis.loop.job import loop_stages
from hil.diagnosis.loop.jobs.stored import LABELS_EXPLAINED, STAGE_LABELS
from hil.diagnosis.loop.procedure import Loop, Turning, close_loop
from hil.figures.error_figures import error_figures
from hil.machine.wiring import connected
from hil.records.journal import Campaign
from hil.ui.terminal.output import print_facts, write_json
from hil.ui.terminal.progress import terminal_progress
from hil.ui.terminal.summary import print_accuracy, print_stages

MARKER = "made-by-hil-demo"
TURNING = Turning(Exploration(runs=4, rows=28, warm_up_s=180.0), most_further=0)


VERIFIED = "extended, verified by ISO 230-2"
"""Name of the last measurement: targets as `hil verify` has them, with a new zero of the instrument."""


@dataclass(frozen=True)
class Times:
    """How long it took the simulated machine, and this computer."""

    machine_s: float
    wall_s: float


def run(args: argparse.Namespace) -> int:
    """Exit status 0: the loop found a cause, reduced the error, and the accuracy is within its limit; 1: not."""
    started = time.perf_counter()
    directory = Path(args.out)
    axis = _lay_out(directory, args.seed)
    store = _store(axis)
    with connected(axis) as machine, terminal_progress() as listener:
        campaign = Campaign.numbered(axis.store.directory, axis.purpose("demo"), resume=False)
        machine.session.prepare(campaign.directory)
        loop = close_loop(machine.session, campaign, axis.correction, store.save, listener, turning=TURNING)
        proof = run_verification(machine, loop.turn.extended, listener)
        machine_s = machine.clock.now_ns() / NS_PER_S
    from hil.diagnosis.loop.report import loop_campaigns, loop_report  # noqa: PLC0415  (plots are slow to import)
    from hil.ui.report.document import before_after_image  # noqa: PLC0415

    replace_file(directory / "report.html", loop_report(axis, loop, proof=proof).encode())
    replace_file(directory / "before-after.png", before_after_image(loop_campaigns(loop)))
    wall_s = time.perf_counter() - started
    return _tell(args, axis, loop, proof, Times(machine_s, wall_s))


def _lay_out(directory: Path, number: int | None) -> AxisConfig:
    """Make the directory with the demo's axis file. One of an earlier demo is replaced. Raises InputError for any other that is not
    empty."""
    if directory.exists():
        if not (directory / MARKER).exists() and any(directory.iterdir()):
            raise InputError("is there already and was not made by a demo; give another one with --out", path=directory)
        shutil.rmtree(directory)
    directory.mkdir(parents=True)
    (directory / MARKER).touch()
    text = files("hil.examples").joinpath("demo_axis.toml").read_text(encoding="utf-8")
    if number is not None:
        text = text.replace("seed = 3", f"seed = {number}")
    replace_file(directory / "axis.toml", text.encode())
    return load_axis(directory / "axis.toml")


def _store(axis: AxisConfig) -> SealedStore:
    """A store with a new builder's key pair. The password is written beside it, as the machine is simulated."""
    password = secrets.token_hex(16)
    replace_file(axis.path.parent / "password", (password + "\n").encode(), mode=0o600)
    key = new_key()
    save_private_key(axis.store.builder_key, key, password)
    save_public_key(axis.store.builder_public, key.public_key())
    return SealedStore.of(axis, password, password)


def _tell(args: argparse.Namespace, axis: AxisConfig, loop: Loop, proof: Verification, times: Times) -> int:
    directory, stages = Path(args.out), {**loop_stages(loop), VERIFY: error_figures(proof.records)}
    found = accuracy_of(axis, proof.records, corrected=True)
    print_accuracy(found)
    print_stages({STAGE_LABELS.get(name, VERIFIED): figures for name, figures in stages.items()})
    print(LABELS_EXPLAINED)
    print_findings(loop.turn.diagnosis)
    before, after = stages["table, explored"]["rms_um"], stages["extended, explored"]["rms_um"]
    noise_um = loop.turn.diagnosis.noise.within_run_um
    print_facts(
        {
            "before, after": f"{before:.2f} µm RMS ({STAGE_LABELS['table, explored']}) -> {after:.2f} µm RMS"
            f" ({STAGE_LABELS['extended, explored']}), noise {noise_um:.2f} µm",
            "machine time": f"{times.machine_s / 60:.1f} min in {times.wall_s:.1f} s,"
            f" {times.machine_s / times.wall_s:.0f} times faster",
            "report": str(directory / "report.html"),
            "axis file": str(directory / "axis.toml"),
            "password": f"{directory / 'password'} opens the sealed tables and the builder's key; the axis file names it",
            "verify it": f"hil verify {directory / 'axis.toml'}",
        }
    )
    good = after < before and bool(loop.turn.diagnosis.findings) and found.good
    if args.json:
        write_json(
            args.json,
            {
                "accuracy": found.as_json(),
                "stages": stages,
                "diagnosis": loop.turn.diagnosis.to_json(),
                "machine_s": times.machine_s,
                "wall_s": times.wall_s,
                "good": good,
                "report": str(directory / "report.html"),
            },
        )
    return 0 if good else 1
