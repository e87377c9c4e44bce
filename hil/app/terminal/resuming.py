"""How to go on with what was interrupted: the command line that resumes a campaign, after a failure and in a list."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.errors import BridgeError, InputError, LocalError
from hil.axis.axis_file import load_axis
from hil.calibration.explore import Exploration
from hil.figures.history import REPLAY, FoundCampaign
from hil.records.journal import FINISHED, Campaign, check_rows

VERBS = ("calibrate", "verify", "close-loop", "lost-motion")
"""That resume; each measures campaigns of a kind of its own name."""
_RESUME = "--resume"
_ONCE = "--record"  # a recording is a new file each time


@dataclass(frozen=True)
class Left:
    """A campaign that can be gone on with, and how many lines of it are confirmed."""

    directory: Path
    lines: int


def left_behind(args: argparse.Namespace) -> Left | None:
    """What the verb of this command line, one of `VERBS`, would resume; None where there is nothing, or what would be refused."""
    kind = REPLAY if getattr(args, "replay", None) else args.resumes
    try:
        found = Campaign.unfinished(load_axis(args.axis).store.directory, kind)
        if found is None:
            return None
        chained = check_rows(found.directory)
        return Left(found.directory, 0 if chained is None else sum(chained.lines.values()))
    except (BridgeError, OSError):
        return None


def how_to_go_on(
    args: argparse.Namespace, argv: Sequence[str], before: Left | None, error: BaseException
) -> str | None:
    """The command that goes on with what this one did not finish; None where it left nothing that it could go on with."""
    now = left_behind(args)
    if now is None or (now == before and not (args.resume and not isinstance(error, LocalError))):
        return None
    words = _without_recording(argv)
    return shlex.join(["hil", *words, *([] if args.resume else [_RESUME])])


def _without_recording(argv: Sequence[str]) -> list[str]:
    kept, skip = [], False
    for word in argv:
        if not skip and word != _ONCE and not word.startswith(f"{_ONCE}="):
            kept.append(word)
        skip = word == _ONCE and not skip
    return kept


def state_of(campaign: FoundCampaign) -> str:
    """Of a campaign in a list: "finished", "unfinished", or "" where its verb does not resume."""
    if (campaign.directory / FINISHED).exists():
        return "finished"
    rows = any(one.records is not None for one in campaign.passes)
    return "unfinished" if rows and campaign.kind in (*VERBS, REPLAY) else ""


def resumed_by(campaign: FoundCampaign) -> str | None:
    """The command that goes on with an unfinished campaign, by what it was started for; None where a later one is resumed instead, or
    its options are not all known."""
    place = campaign.directory.parent
    found = Campaign.unfinished(place, campaign.kind) if campaign.kind in VERBS else None
    if found is None or found.directory.resolve() != campaign.directory.resolve():
        return None
    options = _options(campaign.purpose)
    if options is None:
        return None
    return shlex.join(["hil", campaign.kind, str(_axis_file(place, campaign.axis)), *options, _RESUME])


def _options(purpose: Mapping[str, Any]) -> list[str] | None:
    seed, exploration = purpose.get("seed", 1), purpose.get("exploration", vars(Exploration()))
    usual = vars(Exploration())
    if "in_motion" in purpose or not isinstance(exploration, dict) or set(exploration) != set(usual):
        return None
    options = [] if seed == 1 else ["--seed", str(seed)]
    for name, flag in (("runs", "--runs"), ("rows", "--rows"), ("warm_up_s", "--warm-up")):
        options += [] if exploration[name] == usual[name] else [flag, f"{exploration[name]:g}"]
    return options


def _axis_file(place: Path, axis: str) -> Path:
    """The axis file that keeps its campaigns there, as far as it stands where it usually does."""
    for path in sorted(place.parent.glob("*.toml")):
        try:
            found = load_axis(path)
        except InputError:
            continue
        if found.name == axis and found.store.directory == place.resolve():
            return path
    return Path("AXIS.toml")
