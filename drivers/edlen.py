"""Refractive index of air; a laser interferometer's wavelength is shorter by it than in vacuum.

Modified Edlén equation: K. P. Birch and M. J. Downs, Metrologia 30 (1993) 155 with the corrections of Metrologia 31 (1994) 315, in
the form of NIST's engineering metrology toolbox; saturation vapour pressure over water by the IAPWS formulation it names.
Good to 1e-7 or better within a workshop's 10 to 35 °C, 800 to 1100 hPa. Pure functions.
"""

from __future__ import annotations

from typing import Any, TypeVar

from drivers.errors import InputError

Quantity = TypeVar("Quantity", bound=Any)
"""A float, or an array of them."""

HELIUM_NEON_VACUUM_NM = 632.9912  # two-frequency laser heads; a plain stabilised tube is at 632.99137 or so


def saturation_vapour_pressure_pa(temperature_c: Quantity) -> Quantity:
    """Saturation vapour pressure over liquid water in Pa, for 0 to 100 °C (IAPWS-IF97, region 4). Float or array, shape kept."""
    t = temperature_c + 273.15
    omega = t - 2.38555575678e-01 / (t - 6.50175348448e02)
    a = omega * omega + 1.16705214528e03 * omega - 7.24213167032e05
    b = -1.70738469401e01 * omega * omega + 1.20208247025e04 * omega - 3.23255503223e06
    c = 1.49151086135e01 * omega * omega - 4.82326573616e03 * omega + 4.05113405421e05
    x = -b + (b * b - 4.0 * a * c) ** 0.5
    pressure_pa: Quantity = 1e6 * (2.0 * c / x) ** 4
    return pressure_pa


def check_air(temperature_c: float, pressure_hpa: float, humidity_percent: float) -> None:
    """Raise InputError for air outside −10…50 °C, 500…1200 hPa, 0…100 % relative humidity."""
    for name, value, low, high in (
        ("air temperature", temperature_c, -10.0, 50.0),
        ("air pressure", pressure_hpa, 500.0, 1200.0),
        ("air humidity", humidity_percent, 0.0, 100.0),
    ):
        if not low <= value <= high:
            raise InputError(f"{name} is {value:g}, expected {low:g} to {high:g}")


def refractive_index(
    temperature_c: float,
    pressure_hpa: float,
    humidity_percent: float,
    vacuum_wavelength_nm: float = HELIUM_NEON_VACUUM_NM,
) -> float:
    """Phase index n of air with 450 ppm CO₂ from °C, hPa, % and nm. Raises InputError outside −10…50 °C, 500…1200 hPa, 0…100 %."""
    check_air(temperature_c, pressure_hpa, humidity_percent)
    return 1.0 + refractivity(temperature_c, pressure_hpa, humidity_percent, vacuum_wavelength_nm)


def refractivity(
    temperature_c: Quantity,
    pressure_hpa: Quantity,
    humidity_percent: Quantity,
    vacuum_wavelength_nm: float = HELIUM_NEON_VACUUM_NM,
) -> Quantity:
    """n − 1 from °C, hPa, % and nm; floats or arrays, shape of the inputs. The inputs are not checked: see `check_air`."""
    s = (1000.0 / vacuum_wavelength_nm) ** 2  # µm⁻²
    standard = 1e-8 * (8342.54 + 2406147.0 / (130.0 - s) + 15998.0 / (38.9 - s))
    pressure_pa = 100.0 * pressure_hpa
    density = (1.0 + 1e-8 * (0.601 - 0.00972 * temperature_c) * pressure_pa) / (1.0 + 0.003661 * temperature_c)
    dry = pressure_pa * standard * density / 96095.43
    vapour_pa = humidity_percent / 100.0 * saturation_vapour_pressure_pa(temperature_c)
    wet: Quantity = dry - 1e-10 * 292.75 / (temperature_c + 273.15) * (3.7345 - 0.0401 * s) * vapour_pa
    return wet
