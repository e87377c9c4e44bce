"""The refractive index of air against published values, and against another equation."""

import pytest

from drivers import ciddor
from drivers.edlen import refractive_index, saturation_vapour_pressure_pa
from drivers.errors import InputError
from sim_backends.plant import air as truth


@pytest.mark.parametrize(
    ("air", "index"),
    [
        ((20.0, 1013.25, 50.0), 1.000271375),
        ((20.0, 1013.25, 0.0), 1.000271799),
        ((25.0, 1013.25, 50.0), 1.000266662),
        ((20.0, 900.0, 50.0), 1.000240985),
    ],
)
def test_check_values_at_the_helium_neon_line(air: tuple[float, float, float], index: float) -> None:
    assert refractive_index(*air, 632.9912) == pytest.approx(index, abs=1e-9)
    assert ciddor.refractive_index(*air, 632.9912) == pytest.approx(index, abs=3e-9)
    assert truth.refractive_index(*air, 632.9912) == pytest.approx(index, abs=1e-8)


@pytest.mark.parametrize(
    ("air", "refractivity_e8"),
    [((20.0, 800.0, 0.0), 21458.0), ((20.0, 1000.0, 0.0), 26824.4), ((20.0, 1200.0, 0.0), 32191.6)],
)
def test_ciddors_own_table(air: tuple[float, float, float], refractivity_e8: float) -> None:
    """Dry air at 633 nm, table 1 of the paper."""
    assert (ciddor.refractive_index(*air, 633.0) - 1.0) * 1e8 == pytest.approx(refractivity_e8, abs=0.1)


def test_sensitivities() -> None:
    at = refractive_index(20.0, 1013.25, 50.0)
    assert (refractive_index(21.0, 1013.25, 50.0) - at) * 1e6 == pytest.approx(-0.95, abs=0.02)
    assert (refractive_index(20.0, 1014.25, 50.0) - at) * 1e6 == pytest.approx(0.27, abs=0.005)
    assert (refractive_index(20.0, 1013.25, 60.0) - at) * 1e6 == pytest.approx(-0.085, abs=0.002)


@pytest.mark.parametrize("temp_c", [10.0, 15.0, 20.0, 30.0, 35.0])
@pytest.mark.parametrize("pressure_hpa", [800.0, 950.0, 1100.0])
@pytest.mark.parametrize("humidity", [0.0, 40.0, 90.0])
def test_two_equations_agree_over_a_workshops_range(temp_c: float, pressure_hpa: float, humidity: float) -> None:
    assert refractive_index(temp_c, pressure_hpa, humidity) == pytest.approx(
        truth.refractive_index(temp_c, pressure_hpa, humidity, 632.9912), abs=4e-8
    )
    assert ciddor.refractive_index(temp_c, pressure_hpa, humidity) == pytest.approx(
        truth.refractive_index(temp_c, pressure_hpa, humidity, 632.9912), abs=1e-9
    )


def test_vapour_pressure_at_the_triple_point_and_at_boiling() -> None:
    assert saturation_vapour_pressure_pa(0.01) == pytest.approx(611.66, rel=1e-4)
    assert saturation_vapour_pressure_pa(99.974) == pytest.approx(101325.0, rel=1e-4)


@pytest.mark.parametrize(
    "air", [(60.0, 1013.0, 50.0), (20.0, 10.13, 50.0), (20.0, 101325.0, 50.0), (20.0, 1013.0, 101.0)]
)
def test_air_that_cannot_be_is_refused(air: tuple[float, float, float]) -> None:
    for equation in (refractive_index, ciddor.refractive_index):
        with pytest.raises(InputError, match=r"air .* expected"):
            equation(*air)
