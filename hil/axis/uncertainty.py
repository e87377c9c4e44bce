"""The [uncertainty] section of an axis file: what is known of instrument and room, for the uncertainty stated in reports."""

from __future__ import annotations

from hil.axis import reader
from hil.axis.reader import Table
from hil.figures.uncertainty import UncertaintyInputs


def read_uncertainty(table: Table) -> UncertaintyInputs:
    """[uncertainty]; each key may be left out."""
    usual = UncertaintyInputs()

    def take(key: str, unit: str) -> float:
        return table.take(key, reader.not_negative, f"a number >= 0 in {unit}", float(getattr(usual, key)))

    inputs = UncertaintyInputs(
        device_um=take("device_um", "µm"),
        device_um_per_m=take("device_um_per_m", "µm/m"),
        misalignment_mm=take("misalignment_mm", "mm"),
        temperature_range_c=take("temperature_range_c", "°C"),
        expansion_um_per_m_c=take("expansion_um_per_m_c", "µm/(m °C)"),
        expansion_range_um_per_m_c=take("expansion_range_um_per_m_c", "µm/(m °C)"),
        deviation_c=table.take("deviation_c", reader.not_negative, "a number >= 0 in °C", None),
        variation_um=take("variation_um", "µm"),
    )
    table.finish()
    return inputs
