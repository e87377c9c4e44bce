"""What the results of jobs that measure along the axis share: the rows of the last pass, their figures, and a plot in a notebook."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

from hil.desk.result import Result
from hil.desk.rows import Rows
from hil.records.rows import Records


@dataclass(frozen=True)
class ErrorFigures:
    """Figures of the errors of some rows, µm. A, R, B and M of ISO 230-2 are None if the rows do not give them."""

    rows: int
    rms_um: float
    mean_um: float
    peak_um: float
    A_um: float | None = None
    R_um: float | None = None
    B_um: float | None = None
    M_um: float | None = None

    @classmethod
    def of(cls, records: Records) -> ErrorFigures:
        """The figures of these rows."""
        from hil.figures.error_figures import error_figures  # noqa: PLC0415  (loads slowly)

        return cls(**error_figures(records))

    @property
    def in_short(self) -> str:
        """A if it is known, else the largest error, µm."""
        return f"peak {self.peak_um:.2f} µm" if self.A_um is None else f"A {self.A_um:.2f} µm"


class MeasuredResult(Result):
    """A result with rows along the axis."""

    @property
    @abstractmethod
    def records(self) -> Records:
        """The rows of the last pass."""

    @property
    def rows(self) -> Rows:
        """The rows of the last pass, as columns."""
        return Rows(self.records.columns)

    def _repr_html_(self) -> str:
        """The sentence and the plot of the errors, for a notebook."""
        from hil.ui.report.data import NamedCampaign  # noqa: PLC0415  (plots are slow to import)
        from hil.ui.report.markup import text  # noqa: PLC0415
        from hil.ui.report.plots import error_plot  # noqa: PLC0415
        from hil.ui.report.svg import LIGHT, file_bytes  # noqa: PLC0415

        svg = file_bytes(error_plot(NamedCampaign(self.axis.name, self.records), LIGHT), "svg").decode()
        return f"<p>{text(self.sentence)}</p>{svg[svg.index('<svg') :]}"
