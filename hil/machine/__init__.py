"""The session at a machine: axes that are moved, watched and stopped together, and the rows that are measured on them.

supervisor     moves the axes, watches them, stops them     watched_axis     one look at a drive and its instrument
instrument_check  instrument against motor                  overspeed        motor speed against commanded speed
position_check motor position against travel and rest       time_out         likely reason of a motion that times out
session        drive, instrument and correction together    set_points       command for a target
measure        a pass of steps, and after a lost beam       dwell            averaging at a target
signals        SIGINT, SIGTERM, SIGHUP                      wiring           axis file -> session (one axis)
machine        a connected axis                   axes_wiring  the same for several axes
links          a machine's links, shared by its drives
canopen_wiring, modbus_wiring, bench_wiring      drives of each wire, and the bench; loaded when an axis file names them
"""
