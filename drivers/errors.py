"""The project's errors as one tree; the branch says which side failed.

    BridgeError
    ├── TransportError        the wire: no answer, or the port is gone
    │   ├── NoAnswerError         a request was not answered in time (it may or may not have been carried out)
    │   │   └── OtherAnswerError      what came in time was no answer to it: another unit, object or length
    │   └── LinkLostError         the bus or port itself went away, or a heartbeat stopped
    │       └── InstrumentLinkError   the instrument's port cannot be opened
    ├── RemoteError           the device answered with a refusal
    │   ├── AbortError            a parameter access was refused (SDO abort, Modbus exception)
    │   ├── DriveFaultError       the drive is in a fault state
    │   └── ProtocolError         the device answered something that its protocol does not allow
    ├── LocalError            this program, or what it was given
    │   ├── InputError            a file or an argument is wrong; carries place, value and what was expected
    │   ├── CapabilityError       this drive or instrument cannot do what was asked
    │   └── StateError            a call that does not fit the present state (moving while not enabled)
    ├── UndoError             several steps failed while settings were put back; its line names each
    └── SafetyError           motion was refused or stopped
        ├── LimitError            a target or speed outside the axis file's limits
        ├── CorrectionBoundError  a correction larger or steeper than the axis file allows
        ├── MotionTimeoutError    a motion did not end in its time
        ├── FollowingErrorError   the axis is further from its set-point than allowed
        ├── OverspeedError        the axis ran faster than commanded
        ├── HeldUnderPowerError   an axis that gravity can move was not shown at rest; it stays under power instead of being disabled
        └── MeasurementLostError  the instrument's signal is gone (beam lost, stale reading)

Callers catch the branch they can do something about; `hil.app.main` turns each into one line on stderr.
"""

from __future__ import annotations

from pathlib import Path


class BridgeError(Exception):
    """Base of all errors that this project raises."""


class TransportError(BridgeError):
    """The wire failed."""


class NoAnswerError(TransportError):
    """A request was not answered in time; whether it was carried out is unknown."""


class OtherAnswerError(NoAnswerError):
    """A request was answered, by something that is no answer to it: of another unit or object, or of another length.

    unit: the Modbus unit that answered for the one that was asked.
    """

    def __init__(self, message: str, unit: int | None = None) -> None:
        super().__init__(message)
        self.unit = unit


class LinkLostError(TransportError):
    """The bus or port went away, or a heartbeat stopped."""


class InstrumentLinkError(LinkLostError):
    """The instrument's port cannot be opened; nothing is wrong with the drive."""


class RemoteError(BridgeError):
    """The device answered with a refusal."""


class AbortError(RemoteError):
    """A parameter access was refused.

    `code` is the SDO abort code or the Modbus exception code.
    """

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code


class DriveFaultError(RemoteError):
    """The drive is in a fault state; `code` is its error code (603Fh), or None."""

    def __init__(self, message: str, code: int | None = None) -> None:
        super().__init__(message)
        self.code = code


class ProtocolError(RemoteError):
    """The device answered something that its protocol does not allow."""


class LocalError(BridgeError):
    """This program failed, or what it was given is wrong."""


class InputError(LocalError):
    """A file or an argument is wrong.

    The message is one line: `place: what is wrong, value, what was expected`.
    """

    def __init__(self, what: str, *, path: str | Path | None = None, line: int | None = None) -> None:
        self.what = what
        self.path = None if path is None else str(path)
        self.line = line
        place = "" if path is None else f"{path}:{line}: " if line is not None else f"{path}: "
        super().__init__(f"{place}{what}")


class CapabilityError(LocalError):
    """This drive or instrument cannot do what was asked."""


class StateError(LocalError):
    """The call does not fit the present state."""


class UndoError(BridgeError):
    """Several steps failed while settings were put back; `errors` are those of the steps, the most dangerous first."""

    def __init__(self, message: str, errors: tuple[BridgeError, ...]) -> None:
        super().__init__(message)
        self.errors = errors


class SafetyError(BridgeError):
    """Motion was refused or stopped."""


class LimitError(SafetyError):
    """A target or a speed lies outside the axis file's limits."""


class CorrectionBoundError(SafetyError):
    """A correction is larger or steeper than the axis file allows; it is not used."""


class UnprovenError(SafetyError):
    """A correction did not bring the improvement that it was computed for; it is not used."""


class MotionTimeoutError(SafetyError):
    """A motion did not end in its time."""


class FollowingErrorError(SafetyError):
    """The axis is further from its set-point than allowed."""


class OverspeedError(SafetyError):
    """The axis ran faster than commanded."""


class HeldUnderPowerError(SafetyError):
    """An axis that gravity can move was not shown at rest; having no brake, it is held by its drive and stays under power."""


class MeasurementLostError(SafetyError):
    """The instrument gives no fresh reading, has lost its beam, or disagrees with the motor.

    followed_ns: time of the last reading that was seen to follow the motor, where they disagree: what was read since may be wrong.
    None where every reading before the loss is good.
    """

    def __init__(self, message: str, *, followed_ns: int | None = None) -> None:
        super().__init__(message)
        self.followed_ns = followed_ns
