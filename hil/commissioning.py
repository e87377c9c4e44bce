"""The API for commissioning scripts, in one import. `hil/examples` has a script for each system.

Nothing is defined here: what the verbs call is what a script calls.
"""

from hil.axis.axis_file import AxisConfig, DriveAxis, accuracy_of, iso_targets, load_axis, load_drive_axis
from hil.axis.backlash import BacklashConfig, default_backlash
from hil.axis.lost_motion import LostMotionConfig, default_lost_motion
from hil.backlash.procedure import TorqueBacklash, measure_backlash
from hil.backlash.result import LostMotion, fitted_lost_motion
from hil.backlash.settings import backlash_settings
from hil.calibration.calibrate import Calibration, calibrate
from hil.calibration.explore import warm_up
from hil.calibration.in_motion import measure_in_motion, plan_passes
from hil.calibration.in_motion_settings import InMotion
from hil.calibration.job import Verification, enter_backlash, verify
from hil.calibration.latency import measure_latency
from hil.calibration.straightness import measure_straightness
from hil.correction.compensation import Compensation
from hil.correction.manual import read_backlash, read_manual_tables, read_straightness
from hil.correction.sealed import load_private_key, load_public_key, new_key, save_private_key, save_public_key
from hil.correction.store import SealedStore
from hil.correction.tables import Band, TableMode, TableSet
from hil.diagnosis import Diagnosis, diagnose, fit_model
from hil.diagnosis.loop.procedure import Loop, Turning, close_loop
from hil.doctor.procedure import Check, doctor
from hil.drive_table import DriveTable, drive_table, wanted_of
from hil.drive_table.change import changing as changing_table
from hil.drive_table.change import held_table, zero_note
from hil.drive_table.change import remember_zero as remember_table_zero
from hil.drive_table.proof import Proof, prove_by_drive, prove_by_instrument
from hil.figures.iso230 import Iso230, iso230
from hil.figures.verdict import Accuracy
from hil.lost_motion.circle.figures import Circle
from hil.lost_motion.circle.procedure import CircleRun, drive_circle
from hil.lost_motion.circle.procedure import prepare as prepare_axes
from hil.lost_motion.fit import MeasuredReversal
from hil.lost_motion.fit import compete as compete_lost_motion
from hil.lost_motion.procedure import LostMotionResult, measure_lost_motion
from hil.machine.axes_wiring import connected_across, connected_axes
from hil.machine.events import Event
from hil.machine.measure import Step, measure
from hil.machine.replay import recorded, replayed
from hil.machine.wiring import Machine, connected, connected_drive
from hil.probe.machine_file import ProbeMachineConfig, load_probe_machine
from hil.probe.procedure import centre_bore, correct, measure_and_store, measure_feature, measure_run_out, serve_codes
from hil.probe.runout import CorrectionCode, RunOut
from hil.probe.store import RunOutStore
from hil.probe.wiring import connected_probe, control_wires, probe_bench
from hil.records.journal import Campaign
from hil.records.rows import Records, read_csv, to_csv
from hil.records.zero import read_zero

__all__ = [
    "Accuracy",
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
    "accuracy_of",
    "backlash_settings",
    "calibrate",
    "centre_bore",
    "changing_table",
    "close_loop",
    "compete_lost_motion",
    "connected",
    "connected_across",
    "connected_axes",
    "connected_drive",
    "connected_probe",
    "control_wires",
    "correct",
    "default_backlash",
    "default_lost_motion",
    "diagnose",
    "doctor",
    "drive_circle",
    "drive_table",
    "enter_backlash",
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
    "measure_feature",
    "measure_in_motion",
    "measure_latency",
    "measure_lost_motion",
    "measure_run_out",
    "measure_straightness",
    "new_key",
    "plan_passes",
    "prepare_axes",
    "probe_bench",
    "prove_by_drive",
    "prove_by_instrument",
    "read_backlash",
    "read_csv",
    "read_manual_tables",
    "read_straightness",
    "read_zero",
    "recorded",
    "remember_table_zero",
    "replayed",
    "save_private_key",
    "save_public_key",
    "serve_codes",
    "to_csv",
    "verify",
    "wanted_of",
    "warm_up",
    "zero_note",
]
