"""Creep after a stop: hil run creep.py X.toml, then hil diagnose on its rows; hil run creep.py --help says the parameters."""

from collections.abc import Iterator

import hil


class Creep(hil.Procedure):
    """Position against time after arriving, at several targets."""

    targets_mm: tuple[float, ...] = (100.0, 20.0, 100.0, 20.0, 100.0)
    velocity_mm_s: float = 50.0
    watch_s: float = 20.0
    every_s: float = 0.5

    def plan(self, axis: hil.Axis) -> Iterator[hil.Move]:
        yield hil.Move("measure", min(self.targets_mm), max(self.targets_mm), self.velocity_mm_s)

    def run(self, axis: hil.Axis) -> Iterator[hil.Row]:
        for run, target_mm in enumerate(self.targets_mm, start=1):
            axis.move_to(target_mm, self.velocity_mm_s)
            if run < axis.first_run:  # on disk already; each target is still reached from the one before
                continue
            for reading in axis.watch(self.watch_s, self.every_s):
                yield reading.row(run)
