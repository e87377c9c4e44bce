"""Sets of drive parameters: backed up, compared, written all or nothing, read back, stored.

    set_file     a set as a TOML file                  formats    a set as DCF or concise DCF
    snapshot     a backup: what drives hold, as sets   compare    a set against what a drive holds
    preflight    checks before the first write, and the time on the bus
    transaction  one drive: write in order, read back  tasks      many drives through the same stages, side by side
    download     the stages of a download              journal    record of a download, for recovery
    recover      resume and rollback                   restart    audit after a restart, factory defaults
    job          functions for terminal and screen     report     outcome of a job

All modules but `formats` and `wiring` use `drivers.raw_parameters` alone, so that they are the same on every wire.
`hil.parameters.wiring` makes the concrete drives from axis files:

    axes = [load_drive_axis("X.toml"), load_drive_axis("Y.toml")]
    with connected_parameters(axes) as drives:
        targets = [Target(drive, read_set("new.toml"), journal_of(axis)) for drive, axis in zip(drives, axes)]
        for report in download(targets, store=True):
            print(report.drive, report.ending.value)
"""

FORMATS = ("toml", "dcf", "cdcf")
"""Forms of a set, by the suffix of its file."""
