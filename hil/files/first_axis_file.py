"""A first axis file: what only the user knows, beside what the drive says of itself."""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

from drivers.drive_notes import AxisFileKey
from drivers.errors import InputError
from drivers.scaling import AxisScaling, ReportedScaling

CANOPEN = "canopen"
"""The name of a drive that describes itself, in place of a drive file's."""


@dataclass(frozen=True)
class AxisFileQuestion:
    """What only the user knows, or the drive may say. numbers: how many, joined by a comma."""

    option: str
    metavar: str
    asks: str
    numbers: int = 1

    @property
    def name(self) -> str:
        return self.option[2:].replace("-", "_")

    def parse(self, text: str) -> list[float]:
        """Its numbers. Raises InputError."""
        try:
            values = [float(Fraction(part.strip())) for part in text.split(",")]
        except (ValueError, ZeroDivisionError):
            values = []
        good = len(values) == self.numbers
        if self.numbers == 1 and good:
            good = values[0] > 0
        if not good:
            what = "two numbers, low,high" if self.numbers == 2 else "a number > 0"
            raise InputError(f"{self.option} is {text!r}, expected {what}")
        return values


TRAVEL = AxisFileQuestion("--travel", "LOW,HIGH", "where the table may go, mm", 2)
VELOCITY = AxisFileQuestion("--max-velocity", "MM_S", "largest speed of the table, mm/s")
ACCELERATION = AxisFileQuestion("--max-acceleration", "MM_S2", "greatest acceleration of the table, mm/s²")
COUNTS = AxisFileQuestion("--counts-per-rev", "N", "position counts of the drive per turn of the motor")
FEED = AxisFileQuestion("--feed", "MM", "travel of the table per turn of the screw, mm")
GEAR = AxisFileQuestion("--gear", "N", "turns of the motor per turn of the screw, such as 5/2")
PORT = AxisFileQuestion("--instrument-port", "PORT", "the instrument's port")
LIMIT = AxisFileQuestion("--accuracy-limit", "UM", "largest accuracy A that is allowed, µm")
QUESTIONS = (TRAVEL, VELOCITY, ACCELERATION, COUNTS, FEED, GEAR, PORT, LIMIT)

USUAL_LIMIT_UM = "10"
"""Stated as assumed in the axis file, µm."""
UNCERTAINTY = """
[uncertainty]    # ASSUMED of a laser interferometer in a workshop, k = 2: put what your certificate and your room say
device_um = 0.1                      # the instrument's certificate: U = device_um + device_um_per_m · length
device_um_per_m = 0.5
misalignment_mm = 0.5                # lateral range of the beam over the travel
temperature_range_c = 0.5            # range of the measured temperature's error
expansion_range_um_per_m_c = 1.0     # range of the expansion of the machine's scale
variation_um = 0.5                   # range of a drift test as long as a campaign
"""


@dataclass
class Answers:
    """What is known for the axis file, and from whom, by question."""

    args: argparse.Namespace
    found: dict[str, tuple[str, str]] = field(default_factory=dict)

    def need(self, question: AxisFileQuestion, read: Any = None, usual: str | None = None) -> tuple[str, str]:
        """The answer and where it is from: the option, else the drive, else what is usual, else the user at a terminal. Raises
        InputError."""
        if question.name not in self.found:
            self.found[question.name] = self._answer(question, read, usual)
        return self.found[question.name]

    def _answer(self, question: AxisFileQuestion, read: Any, usual: str | None) -> tuple[str, str]:
        given = getattr(self.args, question.name)
        if given is not None:
            return given, "as you gave it"
        if read is not None:
            return f"{float(read):.12g}", "read from the drive"
        if usual is not None:
            return usual, "assumed; change it where it is wrong"
        if not sys.stdin.isatty():
            raise InputError(f"{question.option} is missing, expected {question.asks} (only you know it)")
        return input(f"{question.asks}: ").strip(), "as you gave it"

    def choose(self, key: AxisFileKey) -> str:
        """One of a key's choices: the option, else the user at a terminal. Raises InputError."""
        given = getattr(self.args, key.key, None)
        if given is None and sys.stdin.isatty():
            given = input(f"{key.key}, {' or '.join(key.choices)} ({key.why}): ").strip()
        if given is None:
            raise InputError(
                f"{key.option} is missing, expected {' or '.join(key.choices)}: {key.why} (only you know it)"
            )
        return str(given)

    def scaling(self, reported: ReportedScaling) -> AxisScaling:
        """The units of position, from what the drive reports and the user says. Raises InputError."""
        gear = GEAR.parse(self.need(GEAR, reported.motor_revs_per_shaft_rev, "1")[0])[0]
        ratio = Fraction(gear).limit_denominator(10_000)
        per_turn = reported.encoder_counts_per_motor_rev
        if (
            reported.position_units_per_shaft_rev is not None
        ):  # positions on the wire are in this unit, not the encoder's
            per_turn = reported.position_units_per_shaft_rev / ratio
        counts = COUNTS.parse(self.need(COUNTS, per_turn)[0])[0]
        feed = FEED.parse(self.need(FEED, reported.feed_mm_per_shaft_rev)[0])[0]
        return AxisScaling(round(counts), feed, ratio, self.args.direction)


@dataclass(frozen=True)
class FirstContact:
    """What was found of a drive. lines: of [drive], None where the drive does not fit its description; notes: in sentences.

    more: lines for the end of the file.
    """

    lines: list[str] | None
    reported: ReportedScaling
    notes: list[str]
    homes: bool = True
    more: tuple[str, ...] = ()


def axis_text(ask: Answers, name: str, found: FirstContact) -> str:
    """The axis file. Raises InputError."""
    reported, notes = found.reported, found.notes
    travel, _ = ask.need(TRAVEL)
    low, high = TRAVEL.parse(travel)
    if not low < high:
        raise InputError(f"--travel is {travel!r}, expected low,high with low below high")
    velocity = VELOCITY.parse(ask.need(VELOCITY)[0])[0]
    acceleration = ACCELERATION.parse(ask.need(ACCELERATION)[0])[0]
    scaling = ask.scaling(reported)
    port = ask.need(PORT)[0]
    limit_um = LIMIT.parse(ask.need(LIMIT, usual=USUAL_LIMIT_UM)[0])[0]
    margin = min(5.0, 0.05 * (high - low))
    lines = [
        "# Made by `hil drives new`. Each figure says where it is from; hil doctor proves the units before anything else is done.",
        *(f"# {' '.join(note.split())}" for note in notes),
        "",
        "[axis]",
        f'name = "{name}"',
        f"travel_min_mm = {low!r}                # as you gave it; nothing is moved outside",
        f"travel_max_mm = {high!r}",
        f"max_velocity_mm_s = {velocity!r}",
        f"max_acceleration_mm_s2 = {acceleration!r}",
        "",
        "[scaling]",
        f"encoder_counts_per_motor_rev = {scaling.encoder_counts_per_motor_rev}    # {ask.found[COUNTS.name][1]}",
        f"feed_mm_per_shaft_rev = {scaling.feed_mm_per_shaft_rev!r}    # {ask.found[FEED.name][1]}",
        f'motor_revs_per_shaft_rev = "{scaling.motor_revs_per_shaft_rev}"    # {ask.found[GEAR.name][1]}',
        f"direction = {scaling.direction}    # hil doctor finds out whether it is turned",
        "",
        "[drive]",
        *(found.lines or ()),
        "",
        "[instrument]",
        f'port = "{port}"',
        "",
        "[measurement]",
        f"first_mm = {low + margin!r}",
        f"last_mm = {high - margin!r}",
        "sections = 11",
        f"velocity_mm_s = {0.5 * velocity!r}",
        f"overrun_mm = {0.5 * margin!r}",
        *([] if found.homes else ["home = false"]),
        *found.more,
        "",
        "[correction]",
        f"accuracy_limit_um = {limit_um!r}    # {ask.found[LIMIT.name][1]}: `hil verify` says pass or fail against it",
        UNCERTAINTY.rstrip("\n"),
    ]
    return "\n".join(lines) + "\n"
