"""The names of `import hil`, which imports this module when the first of them is used."""

from drivers.errors import (
    AbortError,
    BridgeError,
    CapabilityError,
    CorrectionBoundError,
    DriveFaultError,
    FollowingErrorError,
    InputError,
    LimitError,
    LinkLostError,
    MeasurementLostError,
    MotionTimeoutError,
    NoAnswerError,
    OverspeedError,
    SafetyError,
    StateError,
    UnprovenError,
)
from hil.backlash.measured import BacklashResult
from hil.correction.sealed.errors import SealedError, WrongPasswordError
from hil.desk.plan import Move
from hil.desk.result import Result
from hil.desk.rows import AxisReading, Rows
from hil.drive_table.result import DriveTableResult
from hil.lost_motion.measured import ReversalResult
from hil.machine.events import Event
from hil.probe.results import BoreResult, FeatureResult, ProbeCorrectionResult, ProbeResult, RunOutResult
from hil.records.made_with import MadeWithError
from hil.records.zero import ZeroError
from hil.script.axis import Axis
from hil.script.open_axis import OpenAxis, open_axes
from hil.script.open_axis import open_axis as open
from hil.script.own_table import OwnTable
from hil.script.parameters import Parameters
from hil.script.probe import Probe, open_probe
from hil.script.procedure import Procedure, Row
from hil.script.results import (
    CalibrationResult,
    DoctorResult,
    LoopResult,
    ParameterComparison,
    ParameterWriting,
    ProcedureResult,
    VerificationResult,
)
from hil.ui.report.measured_result import ErrorFigures, MeasuredResult

__all__ = [
    "AbortError",
    "Axis",
    "AxisReading",
    "BacklashResult",
    "BoreResult",
    "BridgeError",
    "CalibrationResult",
    "CapabilityError",
    "CorrectionBoundError",
    "DoctorResult",
    "DriveFaultError",
    "DriveTableResult",
    "ErrorFigures",
    "Event",
    "FeatureResult",
    "FollowingErrorError",
    "InputError",
    "LimitError",
    "LinkLostError",
    "LoopResult",
    "MadeWithError",
    "MeasuredResult",
    "MeasurementLostError",
    "MotionTimeoutError",
    "Move",
    "NoAnswerError",
    "OpenAxis",
    "OverspeedError",
    "OwnTable",
    "ParameterComparison",
    "ParameterWriting",
    "Parameters",
    "Probe",
    "ProbeCorrectionResult",
    "ProbeResult",
    "Procedure",
    "ProcedureResult",
    "Result",
    "ReversalResult",
    "Row",
    "Rows",
    "RunOutResult",
    "SafetyError",
    "SealedError",
    "StateError",
    "UnprovenError",
    "VerificationResult",
    "WrongPasswordError",
    "ZeroError",
    "open",
    "open_axes",
    "open_probe",
]

for _name in __all__:
    if _name.endswith("Error"):
        globals()[_name].__module__ = "hil"  # as a script catches it, in a traceback
