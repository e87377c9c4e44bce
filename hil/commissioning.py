"""Everything a commissioning script needs, in one import. `hil/examples` shows each at work.

Nothing is defined here: what the verbs call is what a script calls.
"""

from hil.axes_wiring import connected_axes
from hil.axis import AxisConfig, DriveAxis, iso_targets, load_axis, load_drive_axis
from hil.axis_backlash import BacklashConfig, default_backlash
from hil.axis_lost_motion import LostMotionConfig, default_lost_motion
from hil.backlash_settings import backlash_settings
from hil.compensation import Compensation
from hil.diagnosis import Diagnosis, diagnose, fit_model
from hil.drive_tables import DriveTable, drive_table, wanted_of
from hil.iso230 import Iso230, iso230
from hil.journal import Campaign
from hil.lost_motion.circle import Circle
from hil.lost_motion.fit import MeasuredReversal
from hil.lost_motion.fit import compete as compete_lost_motion
from hil.manual import read_manual_tables, read_straightness
from hil.probe_machine import ProbeMachineConfig, load_probe_machine
from hil.probe_wiring import connected_probe, probe_bench
from hil.procedures.calibrate import Calibration, calibrate
from hil.procedures.circle import CircleRun, drive_circle
from hil.procedures.circle import prepare as prepare_axes
from hil.procedures.close_loop import Loop, Turning, close_loop
from hil.procedures.doctor import Check, doctor
from hil.procedures.drive_table import changing as changing_table
from hil.procedures.drive_table import held_table
from hil.procedures.events import Event
from hil.procedures.in_motion import InMotion, measure_in_motion, plan_passes
from hil.procedures.latency import measure_latency
from hil.procedures.lost_motion import LostMotionResult, measure_lost_motion
from hil.procedures.measure import Step, measure
from hil.procedures.probe_runout import centre_bore, correct, measure_and_store, measure_run_out
from hil.procedures.prove_drive_table import Proof, prove_by_drive, prove_by_instrument
from hil.procedures.torque_backlash import TorqueBacklash, measure_backlash
from hil.procedures.verify import Verification, verify
from hil.procedures.warm_up import warm_up
from hil.records import Records, read_csv, to_csv
from hil.replay_wiring import recorded, replayed
from hil.runout import CorrectionCode, RunOut
from hil.runout_store import RunOutStore
from hil.sealed import load_private_key, load_public_key, new_key, save_private_key, save_public_key
from hil.store import SealedStore
from hil.tables import Band, TableMode, TableSet
from hil.wind_up.result import LostMotion, fitted_lost_motion
from hil.wiring import Machine, connected, connected_drive

__all__ = [
    "AxisConfig",
    "BacklashConfig",
    "Band",
    "Calibration",
    "Campaign",
    "Check",
    "Circle",
    "CircleRun",
    "Compensation",
    "CorrectionCode",
    "Diagnosis",
    "DriveAxis",
    "DriveTable",
    "Event",
    "InMotion",
    "Iso230",
    "Loop",
    "LostMotion",
    "LostMotionConfig",
    "LostMotionResult",
    "Machine",
    "MeasuredReversal",
    "ProbeMachineConfig",
    "Proof",
    "Records",
    "RunOut",
    "RunOutStore",
    "SealedStore",
    "Step",
    "TableMode",
    "TableSet",
    "TorqueBacklash",
    "Turning",
    "Verification",
    "backlash_settings",
    "calibrate",
    "centre_bore",
    "changing_table",
    "close_loop",
    "compete_lost_motion",
    "connected",
    "connected_axes",
    "connected_drive",
    "connected_probe",
    "correct",
    "default_backlash",
    "default_lost_motion",
    "diagnose",
    "doctor",
    "drive_circle",
    "drive_table",
    "fit_model",
    "fitted_lost_motion",
    "held_table",
    "iso230",
    "iso_targets",
    "load_axis",
    "load_drive_axis",
    "load_private_key",
    "load_probe_machine",
    "load_public_key",
    "measure",
    "measure_and_store",
    "measure_backlash",
    "measure_in_motion",
    "measure_latency",
    "measure_lost_motion",
    "measure_run_out",
    "new_key",
    "plan_passes",
    "prepare_axes",
    "probe_bench",
    "prove_by_drive",
    "prove_by_instrument",
    "read_csv",
    "read_manual_tables",
    "read_straightness",
    "recorded",
    "replayed",
    "save_private_key",
    "save_public_key",
    "to_csv",
    "verify",
    "wanted_of",
    "warm_up",
]
