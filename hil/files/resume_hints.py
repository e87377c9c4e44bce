"""Commands that resume an interrupted campaign, as printed after a failure and in a list of campaigns."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.errors import BridgeError, InputError, LocalError
from hil.axis.axis_file import AxisConfig, load_axis
from hil.axis.zero import zero_keeper
from hil.calibration.explore import Exploration
from hil.calibration.spacing import KIND as DENSE
from hil.desk.plan import OF_PROCEDURE
from hil.figures.history import REPLAY, FoundCampaign
from hil.records.journal import DISCARDED, FINISHED, Campaign, check_resumable
from hil.records.zero import FILE, ZeroError, read_zero, what_shows_it

VERBS = ("calibrate", "verify", "close-loop", "lost-motion")
"""Verbs with `--resume`; each measures campaigns of its own name."""
_RESUME = "--resume"
_NOT_AGAIN = ("--new-zero", "--instrument-zeroed")
"""Options about the axis before the first run; they are not repeated."""
_ONCE = "--record"
"""Option with a new file for each run; it is not repeated."""


@dataclass(frozen=True)
class Unfinished:
    """An unfinished campaign. lines: number of its confirmed lines.

    refused: why resuming it will be refused, "" where no reason is known; needs: what resuming needs, such as a homing.
    """

    directory: Path
    lines: int
    refused: str = ""
    needs: str = ""


def find_unfinished(args: argparse.Namespace) -> Unfinished | None:
    """The campaign that the verb of this command line would resume, or refuse to; None for none."""
    replay = getattr(args, "replay", None)
    try:
        axis = load_axis(args.axis)
        before = [DENSE] if getattr(args, "dense", False) else []  # it ends together with its calibration
        for kind in [REPLAY] if replay else [*before, args.resumes]:
            found = Campaign.unfinished(axis.store.directory, kind)
            if found is not None:
                return _left(found.directory, None if replay else axis)
        return None
    except (BridgeError, OSError):
        return None


def _left(directory: Path, axis: AxisConfig | None) -> Unfinished:
    """axis: whose zero the rows must have; None for rows of a recording, and where its file is unknown. Raises OSError."""
    lines = 0
    try:
        chained = check_resumable(directory)
        lines = 0 if chained is None else sum(chained.lines.values())
        rows = read_zero(directory / FILE)
        known = None if axis is None else zero_keeper(axis).kept(rows)
    except (InputError, ZeroError) as error:
        return Unfinished(directory, lines, refused=" ".join(str(error).split()))
    needs = None if axis is None or known is None else what_shows_it(known, absolute_encoder=axis.absolute_encoder)
    return Unfinished(directory, lines, needs=needs or "")


def resume_hints(
    args: argparse.Namespace, argv: Sequence[str], before: Unfinished | None, error: BaseException
) -> list[str]:
    """Messages on how to resume what this command line did not finish, the command last; empty where it left nothing.

    before: the unfinished campaign before the command line ran; error: that ended it.
    """
    now = find_unfinished(args)
    if now is None or isinstance(error, ZeroError):  # resuming finds the same zero: the error says what to do
        return []
    if now == before and not (args.resume and not isinstance(error, LocalError)):
        return []
    if now.refused:
        return [] if now.refused in str(error) else [f"cannot be resumed: {now.refused}"]
    words = _said_again(argv)
    command = shlex.join(["hil", *words, *([] if args.resume else [_RESUME])])
    return [*([now.needs] if now.needs else []), f"go on with: {command}"]


def _said_again(argv: Sequence[str]) -> list[str]:
    kept, skip = [], False
    for word in argv:
        once = word == _ONCE or word.startswith(f"{_ONCE}=") or word in _NOT_AGAIN
        if not skip and not once:
            kept.append(word)
        skip = word == _ONCE and not skip
    return kept


def state_of(campaign: FoundCampaign) -> str:
    """State of a campaign in a list: "finished", "unfinished", "discarded", or "" where its verb does not resume."""
    if (campaign.directory / FINISHED).exists():
        return "finished"
    if (campaign.directory / DISCARDED).exists():
        return "discarded"
    rows = any(one.records is not None for one in campaign.passes)
    resumed = campaign.kind in (*VERBS, REPLAY, DENSE) or campaign.kind.startswith(OF_PROCEDURE)
    return "unfinished" if rows and resumed else ""


@dataclass(frozen=True)
class ResumeCommand:
    """How to resume an unfinished campaign. command: None where a later campaign is resumed instead, its options are not all known,
    or it will be refused; refused, needs: as of `Unfinished`."""

    command: str | None = None
    refused: str = ""
    needs: str = ""

    def sentence(self) -> str:
        """As one sentence, "" where there is nothing to resume."""
        if self.refused:
            return f"cannot be resumed: {self.refused}"
        needs = f" ({self.needs})" if self.needs else ""
        return f"go on with {self.command}{needs}" if self.command else ""


def resume_command(campaign: FoundCampaign) -> ResumeCommand:
    """The command that resumes a campaign, from the purpose stored with it."""
    place = campaign.directory.parent
    found = Campaign.unfinished(place, campaign.kind) if campaign.kind in VERBS else None
    if found is None or found.directory.resolve() != campaign.directory.resolve():
        return ResumeCommand()
    path = _axis_file(place, campaign.axis)
    try:
        left = _left(campaign.directory, None if path is None else load_axis(path))
    except OSError as error:
        return ResumeCommand(refused=str(error))
    options = _options(campaign.purpose)
    if left.refused or options is None:
        return ResumeCommand(refused=left.refused)
    return ResumeCommand(
        shlex.join(["hil", campaign.kind, str(path or "AXIS.toml"), *options, _RESUME]), needs=left.needs
    )


def _options(purpose: Mapping[str, Any]) -> list[str] | None:
    seed, exploration = purpose.get("seed", 1), purpose.get("exploration", vars(Exploration()))
    usual = vars(Exploration())
    if "in_motion" in purpose or not isinstance(exploration, dict) or set(exploration) != set(usual):
        return None
    options = [] if seed == 1 else ["--seed", str(seed)]
    for name, flag in (("runs", "--runs"), ("rows", "--rows"), ("warm_up_s", "--warm-up")):
        options += [] if exploration[name] == usual[name] else [flag, f"{exploration[name]:g}"]
    return options


def _axis_file(place: Path, axis: str) -> Path | None:
    """The axis file whose campaigns are in `place`, None where it is not in the usual folder."""
    for path in sorted(place.parent.glob("*.toml")):
        try:
            found = load_axis(path)
        except InputError:
            continue
        if found.name == axis and found.store.directory == place.resolve():
            return path
    return None
