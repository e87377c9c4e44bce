"""The true refractive index of air, by Ciddor's equation.

P. E. Ciddor, Applied Optics 35 (1996) 1566, 450 ppm CO₂, with the vapour pressure of the CIPM-81/91 density formula. Deliberately
another equation, from other sources, than the one by which instruments are compensated.
"""

from __future__ import annotations

import math

_K0, _K1, _K2, _K3 = 238.0185, 5792105.0, 57.362, 167917.0  # µm⁻², dispersion of dry air
_W = (295.235, 2.6422, -0.03238, 0.004028)  # dispersion of water vapour
_GAS = 8.314472  # J/(mol K)
_M_WATER = 0.018015  # kg/mol
_M_AIR = 0.0289635 + 1.2011e-8 * 50.0


def refractive_index(air_c: float, pressure_hpa: float, humidity_percent: float, wavelength_nm: float) -> float:
    """Phase index from °C, hPa, % relative humidity and a vacuum wavelength in nm."""
    s = (1000.0 / wavelength_nm) ** 2
    t, p = air_c, pressure_hpa * 100.0
    kelvin = t + 273.15
    saturated = math.exp(1.2378847e-5 * kelvin**2 - 1.9121316e-2 * kelvin + 33.93711047 - 6343.1645 / kelvin)
    enhancement = 1.00062 + 3.14e-8 * p + 5.60e-7 * t * t
    x = humidity_percent / 100.0 * enhancement * saturated / p
    dry = 1e-8 * (_K1 / (_K0 - s) + _K3 / (_K2 - s))
    vapour = 1.022e-8 * (_W[0] + _W[1] * s + _W[2] * s * s + _W[3] * s**3)
    q = p / kelvin
    z = (
        1.0
        - q
        * (
            1.58123e-6
            - 2.9331e-8 * t
            + 1.1043e-10 * t * t
            + (5.707e-6 - 2.051e-8 * t) * x
            + (1.9898e-4 - 2.376e-6 * t) * x * x
        )
        + q * q * (1.83e-11 - 0.765e-8 * x * x)
    )
    dry_density = (1.0 - x) * p * _M_AIR / (z * _GAS * kelvin)
    vapour_density = x * p * _M_WATER / (z * _GAS * kelvin)
    standard_density = 101325.0 * _M_AIR / (0.9995922115 * _GAS * 288.15)
    return 1.0 + dry_density / standard_density * dry + vapour_density / 0.00985938 * vapour
