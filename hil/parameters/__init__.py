"""Whole sets of drive parameters: backed up, compared, written all or nothing, proven, kept.

    set_file     a set as a TOML file                  formats    the same as DCF or concise DCF
    snapshot     what drives hold, as sets             compare    a set against what a drive holds
    preflight    may it be written at all              order      what first
    transaction  one drive: write, prove, or put back  works      many drives through the same stages, side by side
    download     the stages of a download              journal    what a power cut leaves to go on from
    recover      resume and rollback                   audit      what is left after a restart
    predict      what it costs on the wire             defaults   the maker's values

Everything but `formats` works against `drivers.raw_parameters` alone, so that it is the same on every wire; `hil.parameters.wiring`
makes the concrete drives from axis files:

    axes = [load_drive_axis("X.toml"), load_drive_axis("Y.toml")]
    with connected_parameters(axes) as drives:
        targets = [Target(drive, read_set("new.toml"), journal_of(axis)) for drive, axis in zip(drives, axes)]
        for report in download(targets, store=True):
            print(report.drive, report.ending.value)
"""
