"""The figures of a diagnosis are those of the model in its file: on machines of the grammar, whose truth shares no code with it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from study.grammar.machine import LOTS, draw

from hil.app.main import main
from hil.effects.model import Model
from hil.records.rows import Records, read_csv, to_csv


@pytest.mark.outside
@pytest.mark.parametrize("lot", LOTS)
@pytest.mark.parametrize("seed", [150_000, 150_001, 150_002])
def test_before_after_and_recommended_are_those_of_the_model_in_the_file(tmp_path: Path, lot: str, seed: int) -> None:
    """On rows that were fitted the file leaves no more than `after` says of rows that were not; each cause that is to be compensated
    is in the file and gains there, or a note says that it is not corrected.
    """
    drawn = draw(lot, seed)
    rows, table, extended, out = (tmp_path / name for name in ("rows.csv", "table.json", "model.json", "out.csv"))
    rows.write_text(to_csv(Records.of(drawn.fit.records)))
    words = ["diagnose", str(rows), "--json", str(tmp_path / "said.json"), "--out", str(extended)]
    if drawn.older is not None:
        (tmp_path / "older.csv").write_text(to_csv(Records.of(drawn.older.records)))
        assert main(["fit", str(tmp_path / "older.csv"), "--out", str(table)]) == 0
        words += ["--model", str(table)]
    main(words)
    assert main(["apply", "--model", str(extended), str(rows), "--out", str(out)]) == 0
    said, model = json.loads((tmp_path / "said.json").read_text()), Model.from_json(extended.read_text())
    before, after = said["before"]["rms_um"], said["after"]["rms_um"]
    fitted, alone = (float(np.sqrt(np.mean(values**2))) for values in (read_csv(out)["residual_um"], _errors(rows)))
    in_file = {term.effect.id for term in model.terms}
    assert fitted < 1.02 * after
    assert said["recommended"] is (after < alone)
    if in_file and all(
        one["action"] == "compensate" for one in said["findings"]
    ):  # a cause of the set-up is left by both
        assert after < before
    notes = " ".join(said["notes"])
    named = {one["effect"] for one in said["findings"] if one["action"] == "compensate"}
    assert in_file <= named or (not named and "is suspected" in notes)
    assert all(f"{name} is not corrected" in notes for name in named - in_file)


def _errors(rows: Path) -> np.ndarray:
    return read_csv(rows).uncorrected_error_um
