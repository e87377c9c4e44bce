"""The [certificate] section of an axis file: what a certificate states of machine, drive and instrument, and between whom.

`hil report --certificate` and `--dcc` need it; nothing else reads it. Paper and Digital Calibration Certificate (DCC) are made of
the same fields; those without default are mandatory in the DCC's schema.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import date
from typing import Annotated, Any

from drivers.toml_types import Limits, SchemaError, Text, Via


def _date(value: Any, _: Any) -> date:
    if type(value) is not date:
        raise ValueError
    return value


Day = Annotated[date, Via(Any, _date, "a date such as 2026-03-31, without quotation marks")]
Country = Annotated[str, Limits(pattern=r"\A[A-Z]{2}\Z", description="a country of ISO 3166-1, such as DE")]


@dataclass(frozen=True)
class Device:
    """A machine, drive or instrument. calibrated, due: of an instrument; certificate: number of its own calibration certificate."""

    model: Text
    serial: Text
    maker: Text = ""
    calibrated: Day | None = None
    due: Day | None = None
    certificate: Text = ""

    def __post_init__(self) -> None:
        if self.calibrated is not None and self.due is not None and not self.calibrated < self.due:
            raise SchemaError("due", f"is {self.due}, expected a day after calibrated, {self.calibrated}")


@dataclass(frozen=True)
class Party:
    """A laboratory or a customer. country: ISO 3166-1, two letters."""

    name: Text
    city: Text
    country: Country
    street: Text = ""
    post_code: Text = ""
    email: Text = ""


@dataclass(frozen=True)
class CertificateConfig:
    """What a certificate states beside the measurement.

    person: who answers for the result; place: where the machine stands, of the schema's words; number: the first part of the
    certificate's number.
    """

    machine: Device
    drive: Device
    instrument: Device
    laboratory: Party
    customer: Party
    person: Text
    place: Annotated[
        str, Limits(pattern=r"\A(laboratory|customer|other)\Z", description="laboratory, customer or other")
    ] = "customer"
    number: Annotated[str, Limits(pattern=r"\A[A-Za-z0-9._-]{1,40}\Z", description="letters, digits, . _ -")] = "hil"
    notes: tuple[Text, ...] = field(default=())
