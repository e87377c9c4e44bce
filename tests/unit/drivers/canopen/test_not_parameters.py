"""Which objects are no parameters: by the standards, by access, by the words of a maker's EDS."""

from __future__ import annotations

import pytest

from drivers.canopen.eds import EdsEntry
from drivers.canopen.not_parameters import Kind, refusal
from drivers.cia402.objects import DataType, Entry


def kind_of(index: int, name: str, access: str = "rw", kind: DataType = DataType.U16, subindex: int = 0) -> Kind | None:
    found = EdsEntry(Entry(index, subindex, kind, name), access, None, None, None, None, False)
    refused = refusal(found)
    return None if refused is None else refused.kind


@pytest.mark.parametrize(
    ("index", "name"),
    [
        # names as they stand in published files
        (0x40C5, "P-PRESET execution"),
        (0x40D1, "ZSG-PRESET"),
        (0x40C0, "Alarm reset"),
        (0x40C2, "Clear alarm history"),
        (0x40C6, "Configuration"),
        (0x4033, "Direct data operation trigger"),
        (0x403E, "Driver input command"),
        (0x2301, "Command Number"),
        (0x2095, "ClearIItExceededFlag"),
        (0x2060, "start_brake_test"),
        (0x2102, "Eu_StartFindPointFlag"),
        (0x2706, "Save all Parameters"),
        (0x207F, "Factory Reset"),
        (0x2800, "Reboot command"),
        (0x31E4, "Internal data recorder controlword"),
        (0x2300, "NanoJ Control"),
        (0x2005, "JOG forward"),
        (0x2010, "Jog"),
    ],
)
def test_commands_of_makers(index: int, name: str) -> None:
    assert kind_of(index, name) is Kind.COMMAND


@pytest.mark.parametrize(
    ("index", "name"),
    [
        (0x415F, "JOG/HOME Torque limit value"),
        (0x2001, "JOG operating velocity"),
        (0x2075, "Position trigger 1"),
        (0x31E2, "Internal data recorder trigger mode"),
        (0x2010, "Profile start velocity 1"),
        (0x20A4, "Stop On Stall"),
        (0x2096, "Chopper Hysteresis Start"),
        (0x2038, "Start Operation delay time"),
        (0x2800, "Reboot delay time in ms"),
        (0x4186, "Stopping timeout at alarm generation"),
        (0x30B0, "Home position"),
        (0x2006, "Preset value"),
        (0x2007, "Fault reset option code"),
        (0x2008, "Velocity command filter time"),
        (0x30A1, "Position controller P gain"),
        (0x605A, "Quick stop option code"),
        (0x607C, "Home offset"),
        (0x6010, "Preset execution"),  # CiA 406, beyond the makers' area: its name decides nothing
    ],
)
def test_parameters_whose_names_sound_like_commands(index: int, name: str) -> None:
    assert kind_of(index, name) is None


def test_kinds_by_the_standards_and_by_access() -> None:
    assert kind_of(0x607A, "target position", kind=DataType.I32) is Kind.TARGET
    assert kind_of(0x687A, "target position of the second axis", kind=DataType.I32) is Kind.TARGET
    assert kind_of(0x8060, "mode of the fifth axis", kind=DataType.I8) is Kind.TARGET
    assert kind_of(0x6042, "vl target velocity") is Kind.TARGET
    assert kind_of(0x402E, "Direct data operation position") is Kind.TARGET
    assert kind_of(0x1010, "store parameters", subindex=1) is Kind.COMMAND
    assert kind_of(0x1003, "error history") is Kind.VOLATILE
    assert kind_of(0x1014, "COB-ID EMCY") is Kind.NODE
    assert kind_of(0x1601, "mapping") is Kind.PDO
    assert kind_of(0x1200, "SDO server") is Kind.CHANNEL
    assert kind_of(0x2000, "anything", "wo") is Kind.COMMAND
    assert kind_of(0x2000, "anything", "ro") is Kind.READ_ONLY
    assert kind_of(0x2000, "anything", "const") is Kind.READ_ONLY
    assert kind_of(0x2000, "program", kind=DataType.DOMAIN) is Kind.DOMAIN
    assert kind_of(0x6085, "quick stop deceleration", kind=DataType.U32) is None
