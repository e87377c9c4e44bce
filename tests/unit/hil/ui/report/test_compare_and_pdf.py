"""Two campaigns set against each other, a report as a PDF, its uncertainty and its signatures, by the verb as a user calls it."""

from __future__ import annotations

import hashlib
import json
import re
import sys
from pathlib import Path

import numpy as np
import pypdfium2 as pdfium
import pytest
from support.bench_axis import PASSWORDS, lay_out

from hil.app.main import main
from hil.correction.sealed import load_private_key, sign_detached
from hil.figures.iso230 import iso230
from hil.figures.target_choice import highest_um
from hil.records.rows import Records, read_csv, to_csv
from hil.ui.report.compare import difference, verdict

TARGETS = np.array([0.0, 51.0, 99.0, 160.0, 204.0, 250.0])


def campaign(
    seed: int, step_um: float = 0.0, targets: np.ndarray = TARGETS, runs: int = 5, noise_um: float = 0.3
) -> Records:
    """A slope along the axis, noise, and a step beyond 150 mm."""
    rng = np.random.default_rng(seed)
    rows = [
        (run, d, p, p + (0.01 * p + d + step_um * (p > 150) + noise_um * rng.normal()) / 1000.0)
        for run in range(1, runs + 1)
        for d in (1, -1)
        for p in targets[::d]
    ]
    return Records.of(dict(zip(("run", "direction", "target_mm", "measured_mm"), zip(*rows, strict=True), strict=True)))


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("a.csv").write_text(to_csv(campaign(1)))
    Path("b.csv").write_text(to_csv(campaign(2, step_um=2.0)))
    return tmp_path


def test_what_moved_is_found_and_what_did_not_is_not() -> None:
    found = difference(campaign(1), campaign(2, step_um=2.0))
    beyond = found.target_mm > 150
    assert found.difference_um[beyond] == pytest.approx(2.0, abs=0.6)
    assert (np.abs(found.difference_um) > found.limit_um)[beyond].all()
    assert found.clear <= 6 + 2
    assert (found.judged, found.between) == (12, 0)


def test_the_limit_holds_for_95_of_100() -> None:
    clear = judged = 0
    for seed in range(120):
        found = difference(campaign(2 * seed), campaign(2 * seed + 1, runs=3))
        clear, judged = clear + found.clear, judged + found.judged
    assert clear / judged == pytest.approx(0.05, abs=0.02)


def test_other_targets_are_compared_between_the_first_one_s() -> None:
    """Along a straight line the means between targets are exact."""
    middle = (TARGETS[:-1] + TARGETS[1:]) / 2
    found = difference(campaign(1, noise_um=0.0), campaign(2, targets=np.r_[middle, 300.0], noise_um=0.0))
    assert (len(found.target_mm), found.between) == (10, 10)
    assert found.difference_um == pytest.approx(0.0, abs=1e-9)
    assert "10 targets are not the other's" in verdict(found)


def test_one_run_has_no_scatter_and_no_common_stretch_no_difference() -> None:
    found = difference(campaign(1, runs=1), campaign(2, runs=1))
    assert found.judged == 0
    assert "no scatter to judge by" in verdict(found)
    assert len(difference(campaign(1), campaign(2, targets=TARGETS + 1000.0)).target_mm) == 0


@pytest.mark.outside
def test_the_verb_compares(place: Path) -> None:
    assert main(["report", "--compare", "a.csv", "b.csv", "--out", "c.html", "--png", "png", "--json", "c.json"]) == 0
    page = Path("c.html").read_text()
    assert "b against a" in page
    assert re.search(r"\d+ of 12 target means differ", page)
    assert Path("png/difference.png").exists()
    assert json.loads(Path("c.json").read_text())["campaigns"][0]["uncertainty_um"] is None


@pytest.mark.parametrize(
    ("argv", "says"),
    [
        (["--compare", "a.csv", "b.csv", "a.csv"], "and not both"),
        ([], "expected record files, or --axis-file"),
        (["a.csv", "--axis-file", "none.toml"], "none.toml: cannot be read"),
    ],
)
def test_what_cannot_be_is_one_line(
    place: Path, argv: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", "--out", "c.html", *argv]) == 2
    assert says in capsys.readouterr().err
    assert not Path("c.html").exists()


@pytest.mark.outside
def test_with_an_axis_file_every_figure_has_its_uncertainty_on_page_and_paper(place: Path) -> None:
    path = lay_out(place / "axis", correction="band_um = [-1.0, 4.0]")
    path.write_text(path.read_text() + "\n[uncertainty]\ndevice_um_per_m = 0.8\nvariation_um = 1.0\n")
    argv = ["report", "a.csv", "--axis-file", str(path), "--out", "r.html", "--pdf", "r.pdf", "--json", "r.json"]
    assert main(argv) == 0
    page = Path("r.html").read_text()
    assert "Uncertainty of measurement" in page
    assert "certificate 0 µm + 0.8 µm/m" in page
    assert "Inside -1 to 4 µm" in page
    stated = json.loads(Path("r.json").read_text())["campaigns"][0]["uncertainty_um"]
    u = 1.0 / np.sqrt(3.0)
    choice = {name: highest_um(curves) for name, curves in iso230(read_csv("a.csv")).curves().items()}
    assert stated["E"] == pytest.approx(np.sqrt((0.8 * 0.25) ** 2 + 2 / 5 * u**2 + choice["E"] ** 2))
    assert stated["R_up"] == pytest.approx(np.hypot(2 * u, choice["R_up"]))
    figures = json.loads(Path("r.json").read_text())["campaigns"][0]["iso230"]["figures_um"]
    assert f"{figures['E']:.2f} ± {stated['E']:.2f}" in page
    paper = pdfium.PdfDocument(Path("r.pdf").read_bytes())
    sheets = [page.get_textpage().get_text_bounded() for page in paper]
    paper.close()
    assert len(sheets) >= 3
    digest = hashlib.sha256(Path("r.html").read_bytes()).hexdigest()
    assert all(digest in sheet for sheet in sheets)
    assert f"{figures['E']:.2f} ± {stated['E']:.2f}" in " ".join(sheets)


@pytest.mark.parametrize(
    ("error", "says"),
    [
        ('ModuleNotFoundError("No module named cssselect2")', "pip install 'hil[report-pdf]'"),
        ('OSError("cannot load library libpango-1.0-0")', "apt-get install libpango-1.0-0"),
    ],
)
def test_a_pdf_without_its_renderer_is_one_line_and_nothing_is_written(
    error: str, says: str, place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (place / "weasyprint.py").write_text(f"print('advice of several lines')\nraise {error}\n")
    monkeypatch.syspath_prepend(place)
    for name in [name for name in sys.modules if name.partition(".")[0] == "weasyprint"]:
        monkeypatch.delitem(sys.modules, name)
    assert main(["report", "a.csv", "--out", "r.html", "--pdf", "r.pdf"]) == 2
    told = capsys.readouterr()
    assert (told.out, len(told.err.splitlines())) == ("", 1)
    assert says in told.err
    assert not Path("r.html").exists()
    assert not Path("r.pdf").exists()
    assert main(["report", "a.csv", "--out", "r.html"]) == 0


@pytest.mark.outside
def test_signatures_are_shown_and_a_bad_one_is_a_verdict(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lay_out(place / "axis")
    key = load_private_key(place / "axis" / "builder.key", PASSWORDS["HIL_KEY_PASSWORD"])
    Path("a.csv.sig").write_bytes(sign_detached(Path("a.csv").read_bytes(), key))
    argv = ["report", "a.csv", "b.csv", "--builder", "axis/builder.pub", "--out", "s.html", "--json", "s.json"]
    assert main(argv) == 0
    page = Path("s.html").read_text()
    assert "signed by" in page
    assert "not signed" in page
    Path("b.csv.sig").write_bytes(sign_detached(Path("a.csv").read_bytes(), key))
    assert main(argv) == 1
    assert "b.csv: signature NOT GOOD" in capsys.readouterr().out
    assert json.loads(Path("s.json").read_text())["signatures"]["b.csv"].startswith("NOT GOOD")
    assert len(read_csv("a.csv")) == 60
