"""The result of a job: its verdict, sentence, figures and report, for the terminal and for scripts."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.errors import CapabilityError, InputError
from drivers.files import replace_file
from hil.axis.axis_file import DriveAxis


@dataclass(frozen=True, repr=False)
class Result(ABC):
    """The result of a job. campaign: the folder of its rows, None for a job without rows."""

    axis: DriveAxis
    campaign: Path | None

    @property
    @abstractmethod
    def good(self) -> bool:
        """The verdict, as the verb's exit status gives it."""

    @property
    @abstractmethod
    def sentence(self) -> str:
        """The result in one short sentence."""

    @abstractmethod
    def form(self) -> Mapping[str, Any]:
        """The result as plain values, as the verb writes it by `--json`."""

    def save(self, path: str | Path | None = None) -> Path:
        """Write the result as JSON and return the path. path: None, beside its rows. Raises InputError for a result without rows."""
        if path is None:
            if self.campaign is None:
                raise InputError("this result has no folder of rows, expected a path")
            path = self.campaign / "script-result.json"
        replace_file(path, (json.dumps(self.form(), indent=2, default=str) + "\n").encode())
        return Path(path)

    def report(self, path: str | Path) -> Path:
        """Write the report as one HTML file. Raises CapabilityError if this kind of result has none."""
        replace_file(path, self._page().encode())
        return Path(path)

    def certificate(self, path: str | Path) -> Path:
        """Write the signed certificate of the last pass, PDF, as `hil report --certificate`, with the key password of `hil.open`.
        Raises CapabilityError if this kind of result has none."""
        raise CapabilityError(f"a {type(self).__name__} is not certified, so {path} is not written: verify() is")

    def _page(self) -> str:
        raise CapabilityError(f"a {type(self).__name__} has no report: save() writes it as JSON")

    def __repr__(self) -> str:
        return f"<{self.sentence}>"
