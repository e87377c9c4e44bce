"""Phase index of air by Ciddor's equation, as an alternative to Edlén's (`air`): P. E. Ciddor, Applied Optics 35 (1996) 1566-1573.

Good to a few 1e-8 between −40 and 100 °C. Density by the BIPM formula (Davis, Metrologia 29 (1992) 67); the steps are those of the
paper's appendix. 450 ppm of CO₂. Pure functions.
"""

from __future__ import annotations

import math

from drivers.edlen import HELIUM_NEON_VACUUM_NM, check_air

_R = 8.314510  # J/(mol K), as in the paper
_DRY_KG = 28.9635e-3 + 12.011e-9 * (450.0 - 400.0)
_WATER_KG = 18.015e-3


def _compressibility(kelvin: float, pressure_pa: float, vapour_share: float) -> float:
    t = kelvin - 273.15
    linear = 1.58123e-6 - 2.9331e-8 * t + 1.1043e-10 * t * t
    linear += (5.707e-6 - 2.051e-8 * t) * vapour_share + (1.9898e-4 - 2.376e-6 * t) * vapour_share**2
    reduced = pressure_pa / kelvin
    return 1.0 - reduced * linear + reduced**2 * (1.83e-11 - 0.765e-8 * vapour_share**2)


def _density(kelvin: float, pressure_pa: float, vapour_share: float) -> tuple[float, float]:
    """Densities of the dry air and of the vapour in it, kg/m³."""
    moles = pressure_pa / (_compressibility(kelvin, pressure_pa, vapour_share) * _R * kelvin)
    return moles * _DRY_KG * (1.0 - vapour_share), moles * _WATER_KG * vapour_share


def refractive_index(
    temperature_c: float,
    pressure_hpa: float,
    humidity_percent: float,
    vacuum_wavelength_nm: float = HELIUM_NEON_VACUUM_NM,
) -> float:
    """Phase index n of air with 450 ppm CO₂ from °C, hPa, % and nm. Raises InputError as `air.refractive_index`."""
    check_air(temperature_c, pressure_hpa, humidity_percent)
    wavenumber2 = (1000.0 / vacuum_wavelength_nm) ** 2  # µm⁻²
    dry = 1e-8 * (5792105.0 / (238.0185 - wavenumber2) + 167917.0 / (57.362 - wavenumber2))
    vapour = 295.235 + 2.6422 * wavenumber2 - 0.03238 * wavenumber2**2 + 0.004028 * wavenumber2**3
    kelvin, pressure_pa = temperature_c + 273.15, 100.0 * pressure_hpa
    saturated_pa = math.exp(1.2378847e-5 * kelvin**2 - 1.9121316e-2 * kelvin + 33.93711047 - 6.3431645e3 / kelvin)
    enhancement = 1.00062 + 3.14e-8 * pressure_pa + 5.6e-7 * temperature_c**2
    share = humidity_percent / 100.0 * enhancement * saturated_pa / pressure_pa
    dry_now, vapour_now = _density(kelvin, pressure_pa, share)
    dry_standard, _ = _density(288.15, 101325.0, 0.0)
    _, vapour_standard = _density(293.15, 1333.0, 1.0)
    return 1.0 + dry * dry_now / dry_standard + 1.022e-8 * vapour * vapour_now / vapour_standard
