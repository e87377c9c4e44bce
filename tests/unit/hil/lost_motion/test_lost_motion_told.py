"""What a terminal and a report's result say of two terms that only their sum determines."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from hil.axis.lost_motion import LostMotionConfig
from hil.correction.rise import TWO_TANH, Rise
from hil.lost_motion.estimate import Estimate, Uncertain
from hil.lost_motion.job import MeasuredLostMotion, facts
from hil.lost_motion.procedure import LostMotionResult

RISE = Rise(TWO_TANH, (51.95, 1.14), (0.0021, 0.4, 0.2))
LENGTHS = {
    "rise_1_mm": Uncertain(0.0021, 0.00002),
    "rise_2_mm": Uncertain(0.4, 90.0),
    "onset_2_mm": Uncertain(0.2, 0.0),
}


def told(first: Uncertain, second: Uncertain) -> dict[str, str]:
    parameters = {"amount_um": Uncertain(53.09, 0.0032), "amount_1_um": first, "amount_2_um": second, **LENGTHS}
    found = Estimate(RISE, parameters, parameters, (), (), 0.0)
    proof = SimpleNamespace(before_um=np.ones(2), after_um=np.zeros(2), over_um=0.1, improvement_um=Uncertain(1.0, 0.0))
    result = SimpleNamespace(estimate=found, stretch=SimpleNamespace(noise_um=0.01), proof=proof)
    how = cast(LostMotionConfig, None)
    return facts(MeasuredLostMotion(how, cast(LostMotionResult, cast(Any, result)), None, Path()), "nothing")


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (Uncertain(51.95, 1075.0), Uncertain(1.14, 1075.0)),  # share the whole in any way
        (Uncertain(51.95, 0.7), Uncertain(1.14, 0.7)),  # the second may not be there
        (Uncertain(53.09, 0.0032), Uncertain(1e-11, 0.0)),  # is not there
    ],
)
def test_amounts_that_are_not_determined_are_not_told(first: Uncertain, second: Uncertain) -> None:
    said = told(first, second)
    assert said["  amount um"] == "53.09 ± 0.0064 (k = 2)"
    assert said["  single amounts"] == "not determined one by one, only their sum"
    assert {name for name in said if name.startswith("  ")} == {"  amount um", "  single amounts", "  rise 1 mm"}


def test_amounts_that_are_determined_are_told() -> None:
    said = told(Uncertain(51.95, 0.1), Uncertain(1.14, 0.1))
    assert (said["  amount 1 um"], said["  amount 2 um"]) == ("51.95 ± 0.2 (k = 2)", "1.14 ± 0.2 (k = 2)")
    assert "  single amounts" not in said
