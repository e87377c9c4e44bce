"""Certificates on paper and as DCC: the same figures everywhere, read by foreign readers, refused where they would mislead."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import re
import subprocess
import sys
from datetime import date
from importlib.resources import files
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pypdfium2 as pdfium
import pytest
import xmlschema
from dcclib.validation.schematron import SchematronValidator
from dsi_unit import DsiUnit

from drivers.errors import InputError
from hil.app.main import main
from hil.axis.axis_file import load_axis
from hil.correction.sealed import new_key, save_private_key, save_public_key
from hil.diagnosis.report.diagnosis import opening
from hil.figures.iso230_4 import iso230_4
from hil.records.journal import Campaign
from hil.records.rows import Records, to_csv
from hil.report import dcc
from hil.report.certificate import UNITS, Certificate, Common, Stated, blocks, loop, of_result, positioning
from hil.ui.report import views
from hil.ui.report.data import NamedCampaign

SECRET = "a long password of the builder"
SCHEMA = os.environ.get("HIL_DCC_SCHEMA", "")
"""Folder with PTB's dcc.xsd 3.2.1, SI_Format.xsd 2.1.0 and xmldsig-core-schema.xsd, which no registry's package carries."""
IDENTITY = """
[certificate]
person = "A. Builder"
machine = { model = "VMC 650", serial = "1234", maker = "Example & Co" }
drive = { model = "S-drive 2", serial = "77-01" }
instrument = { model = "uMD2", serial = "0042", calibrated = 2026-03-31, due = 2027-03-31, certificate = "D-K-123" }
laboratory = { name = "Example Metrology", city = "Braunschweig", country = "DE", email = "lab@example.org" }
customer = { name = "Example Works", city = "Jena", country = "DE" }
"""


def rows(targets: np.ndarray, offset_um: float = 1.0, runs: int = 5) -> Records:
    """Five bidirectional runs of a corrected axis, with scatter, time and air."""
    rng = np.random.default_rng(3)
    table = [
        (
            run,
            d,
            p,
            p + (0.004 * p + offset_um * d + 0.2 * rng.normal()) / 1000,
            p - 0.003,
            20.0 * run + 0.1 * k,
            20.5 + 0.1 * run,
        )
        for run in range(1, runs + 1)
        for d in (1, -1)
        for k, p in enumerate(targets[::d])
    ]
    names = ("run", "direction", "target_mm", "measured_mm", "command_mm", "time_s", "air_temp_c")
    return Records.of(dict(zip(names, np.array(table).T, strict=True)))


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An axis file with [certificate], its key, and records at other targets, begun on a stated day."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HIL_KEY_PASSWORD", SECRET)
    demo = (files("hil.examples") / "demo_axis.toml").read_text(encoding="utf-8")
    few = demo.replace("sections = 21", "sections = 7")  # each row of a campaign waits for the disk
    Path("x.toml").write_text(few + IDENTITY, encoding="utf-8")
    key = new_key()
    save_private_key("builder.key", key, SECRET)
    save_public_key("builder.pub", key.public_key())
    head, _, body = to_csv(rows(other_targets())).partition("\n")
    Path("verify.csv").write_text(f"{head}\n# begun 2026-11-20T23:59:30+00:00, rows chained\n{body}")
    return tmp_path


def other_targets() -> np.ndarray:
    own = np.array(load_axis("x.toml").measurement.targets_mm)
    return np.round((own[1:] + own[:-1]) / 2, 3)


def common(**more: Any) -> Common:
    axis = load_axis("x.toml")
    day = date(2026, 11, 20)
    return dataclasses.replace(Common(axis, {"r.csv": "ab" * 32}, day, day, "2026-11-21 10:00 UTC"), **more)


def made() -> Certificate:
    return positioning(common(), NamedCampaign("verify", rows(other_targets()), source="r.csv"))


def call(*argv: str) -> int:
    return main(["report", *argv])


def text_of(pdf: str | Path) -> tuple[int, str]:
    document = pdfium.PdfDocument(Path(pdf).read_bytes())
    pages = [document[i].get_textpage().get_text_bounded() for i in range(len(document))]
    document.close()
    return len(pages), " ".join(" ".join(pages).split())


PYDCC = """
import json, sys, warnings
from types import ModuleType
warnings.simplefilter("ignore")
# it needs oscrypto, which does not know the numbers of newer OpenSSL releases; only its check of signatures uses it
for name in ("CertificateValidator", "errors", "ValidationContext"):
    setattr(sys.modules.setdefault("certvalidator", ModuleType("certvalidator")), name, None)
from dcc.dcc import DCC
for read in map(DCC, sys.argv[1:]):
    print(json.dumps({"uid": read.uid(), "version": read.version(), "date": str(read.calibration_date().date()),
                      "laboratory": read.calibration_laboratory_name(),
                      "figures": read.get_calibration_results("value", "en")}))
"""


def read_by_pydcc(home: Path, *files: Path) -> list[dict[str, object]]:
    """In its own process: it warns on import, and looks for schemas in the home folder, or on the network where there are none."""
    workspace = home / "pydcc"
    workspace.mkdir(exist_ok=True)
    (workspace / "Readme.txt").write_text("no schemas")
    (workspace / "data.json").write_text("{}")
    done = subprocess.run(
        [sys.executable, "-c", PYDCC, *map(str, files)],
        capture_output=True,
        text=True,
        env={**os.environ, "HOME": str(home)},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


def values_of(xml: bytes) -> dict[str, tuple[float, str, float | None]]:
    """own type of each quantity with one value, such as "A" of hil_A -> value, unit, U, by ElementTree alone."""
    ns = {"d": dcc.DCC, "s": dcc.SI}
    found = {}
    for quantity in ET.fromstring(xml).iterfind(".//d:result//d:quantity", ns):
        real = quantity.find("s:real", ns)
        if real is not None:
            spread = real.findtext("s:expandedUnc/s:uncertainty", None, ns)
            value, unit = real.findtext("s:value", "", ns), real.findtext("s:unit", "", ns)
            found[str(quantity.get("refType")).rpartition(" hil_")[2]] = (
                float(value),
                unit,
                None if spread is None else float(spread),
            )
    return found


@pytest.mark.outside
def test_a_campaign_has_the_same_figures_in_json_report_certificate_and_dcc(place: Path) -> None:
    argv = ["verify.csv", "--axis-file", "x.toml", "--out", "r.html", "--pdf", "r.pdf", "--json", "r.json"]
    assert call(*argv, "--certificate", "c.pdf", "--dcc", "c.xml") == 0
    campaign = json.loads(Path("r.json").read_text())["campaigns"][0]
    sheets, paper = text_of("c.pdf")
    assert sheets in (2, 3)
    page = Path("r.html").read_text(encoding="utf-8")
    _, sheets_of_report = text_of("r.pdf")
    xml = values_of(Path("c.xml").read_bytes())
    (foreign,) = read_by_pydcc(place, Path("c.xml"))
    by_name = {name.split(" Figures ")[-1]: form for name, form in foreign["figures"] if " Figures " in name}  # type: ignore[attr-defined]
    for name, value in campaign["iso230"]["figures_um"].items():
        expanded = campaign["uncertainty_um"][name]
        assert xml[name] == (value, r"\micro\metre", expanded)
        real = by_name[name]["real"]
        assert (float(real["value"]), float(real["expandedUnc"]["uncertainty"])) == (value, expanded)
        shown = f"{value:.2f} ± {expanded:.2f}"
        assert shown in page
        assert shown in sheets_of_report
        assert f"{value:.2f} {expanded:.2f} µm" in paper
    assert foreign["date"] == "2026-11-21"  # begun half a minute before midnight
    for word in (
        "1234",
        "77-01",
        "0042",
        "2026-03-31",
        "D-K-123",
        "ISO 230-2:2014",
        "ISO 14253-1",
        "pass",
        "Example & Co",
    ):
        assert word in paper
    digest = hashlib.sha256(Path("verify.csv").read_bytes()).hexdigest()
    assert digest in paper.replace(" ", "")
    assert digest in Path("c.xml").read_text(encoding="utf-8")


def test_both_are_signed_and_a_changed_byte_is_noticed(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call("verify.csv", "--axis-file", "x.toml", "--dcc", "c.xml") == 0
    assert "against a limit of 8.00 µm: pass" in capsys.readouterr().out
    assert main(["check", "c.xml", "--builder", "builder.pub"]) == 0
    Path("c.xml").write_bytes(Path("c.xml").read_bytes().replace(b">pass<", b">fail<"))
    assert main(["check", "c.xml", "--builder", "builder.pub"]) == 1


@pytest.mark.parametrize(
    ("times_u", "word"),
    [(2.0, "pass"), (0.5, "conditionalPass"), (-0.5, "conditionalFail"), (-2.0, "fail")],
)
def test_the_verdict_follows_the_limit(
    place: Path, capsys: pytest.CaptureFixture[str], times_u: float, word: str
) -> None:
    """The limit lies some times U above A. ILAC-G8 splits what is undecided by the side that A is on."""
    accuracy = made().stated[0]
    limit = accuracy.value + times_u * (accuracy.expanded or 0.0)
    status = call("verify.csv", "--axis-file", "x.toml", "--dcc", "c.xml", "--limit", f"{limit:.9f}")
    assert status == (1 if word == "fail" else 0)
    assert f": {'undecided' if 'cond' in word else word}." in capsys.readouterr().out
    assert f"<dcc:conformity>{word}</dcc:conformity>" in Path("c.xml").read_text(encoding="utf-8")


def test_what_would_mislead_is_refused(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    own = np.array(load_axis("x.toml").measurement.targets_mm)
    Path("own.csv").write_text(to_csv(rows(own)))
    bare = Path("x.toml").read_text().partition("[certificate]")[0]
    Path("bare.toml").write_text(bare)
    Path("mixed.csv").write_text(to_csv(rows(np.array([own[0], *other_targets()]))))
    for argv, said in (
        (["own.csv", "--axis-file", "x.toml", "--measured", "2026-11-20"], "at the calibrated targets"),
        (["mixed.csv", "--axis-file", "x.toml", "--measured", "2026-11-20"], "partly at the calibrated targets"),
        (["own.csv", "--axis-file", "x.toml"], "does not say when it was measured"),
        (["verify.csv", "--axis-file", "bare.toml"], "has no [certificate]"),
        (["verify.csv"], "needs --axis-file"),
        (["verify.csv", "--axis-file", "x.toml", "--measured", "20.11.2026"], "expected a date such as"),
        (["--result", "x.toml", "--axis-file", "x.toml", "--measured", "2026-11-20"], "is not JSON"),
    ):
        assert call(*argv, "--dcc", "c.xml") == 2
        assert said in capsys.readouterr().err
        assert not Path("c.xml").exists()


@pytest.mark.filterwarnings(
    r"ignore:The dsi string contains the token '.per'"
)  # it takes \percent for \per, and is right otherwise
def test_every_unit_is_one_of_ptb_s_d_si() -> None:
    for unit, form in UNITS.items():
        assert DsiUnit(form).valid, unit
    with pytest.warns(RuntimeWarning, match="does not match any D-SI units"):
        assert not DsiUnit(r"\micron").valid


def test_a_wrong_unit_and_an_empty_mandatory_text_fail(place: Path) -> None:
    with pytest.raises(InputError, match="expected a unit of"):
        Stated("A", "accuracy", 1.0, "um")
    good = made()
    config = good.config
    for wrong, said in (
        (dataclasses.replace(good, config=dataclasses.replace(config, person=" ")), "content is empty"),
        (dataclasses.replace(good, standard=""), "norm is empty"),
        (dataclasses.replace(good, stated=(dataclasses.replace(good.stated[0], value=float("nan")),)), "finite"),
    ):
        with pytest.raises(InputError, match=said):
            dcc.to_xml(wrong)
    text = Path("x.toml").read_text()
    for key in ("person", "machine", "instrument", "laboratory", "customer"):
        lines = [line for line in text.splitlines() if not line.startswith(f"{key} = ")]
        Path("y.toml").write_text("\n".join(lines))
        with pytest.raises(InputError, match=key):
            load_axis("y.toml")


def circle_result() -> dict[str, object]:
    angle = np.radians(np.arange(360.0))
    away = 100.0 + 0.004 * np.cos(2 * angle)
    x, y = away * np.cos(angle), away * np.sin(angle)
    return {"paths": ["a", "b"], "iso230_4": iso230_4([(x, y), (x[::-1].copy(), y[::-1].copy())], 100.0).as_json()}


PROBE = {
    "machine": "M",
    "mode": "latch",
    "turns": [{}],
    "run_out": {"x_mm": 0.003, "y_mm": 0.004, "tip_radius_mm": 2.998, "closure_um": 0.1},
}
FOUND = {
    "findings": [
        {
            "effect": "cyclic",
            "parameters": {"period_mm": {"value": 10.0, "std": 0.003}, "amplitude_um": {"value": 1.3, "std": 0.04}},
            "confidence": 0.99,
        }
    ],
    "noise_floor_um": 0.3,
}


def every_kind() -> dict[str, Certificate]:
    before, after = (
        NamedCampaign(name, rows(other_targets(), size)) for name, size in (("before", 4.0), ("after", 1.0))
    )
    return {
        "positioning": made(),
        "loop": loop(common(), before, after, FOUND),
        "circle": of_result(common(limit_um=20.0), circle_result()),
        "probe": of_result(common(), PROBE),
        "simulated": positioning(common(simulated=True), NamedCampaign("verify", rows(other_targets(), runs=3))),
    }


def test_pydcc_reads_the_figures_of_every_kind(place: Path) -> None:
    kinds = every_kind()
    files = [place / f"{kind}.xml" for kind in kinds]
    for file, certificate in zip(files, kinds.values(), strict=True):
        file.write_bytes(dcc.to_xml(certificate))
    for read, certificate in zip(read_by_pydcc(place, *files), kinds.values(), strict=True):
        assert read["uid"] == certificate.number
        assert read["laboratory"] == "Example Metrology"
        figures = [form["real"] for name, form in read["figures"] if " Figures " in name]  # type: ignore[attr-defined]
        assert [float(one["value"]) for one in figures] == [one.value for one in certificate.stated]
        assert [one["unit"] for one in figures] == [UNITS[one.unit] for one in certificate.stated]


def test_circle_and_probe_by_hand(place: Path) -> None:
    kinds = every_kind()
    circle = {one.symbol: one for one in kinds["circle"].stated}
    assert circle["G(b)"].value == pytest.approx(8.0, abs=1e-3)
    assert circle["F_max ccw"].value == pytest.approx(4.0, abs=1e-3)
    assert kinds["circle"].verdict is not None
    assert kinds["circle"].verdict.value == "undecided"  # no uncertainty is known of it
    assert {one.symbol: one.value for one in kinds["probe"].stated}["run-out"] == pytest.approx(5.0)
    sentence = kinds["loop"].sentence
    for said in ("cyclic", "period 10 ± 0.006 mm", "confidence 99.0 %", "fell from", "(before", "(after"):
        assert said in sentence
    assert views.with_unit("alpha_ppm_per_k") == ("alpha", "ppm/K")
    assert views.with_unit("slope_um_per_m") == ("slope", "µm/m"), "neither of no unit nor in m"
    assert views.with_unit("compliance_um_per_kg") == ("compliance", "µm/kg")
    assert views.with_unit("gain_um_per_mm") == ("gain", "µm/mm")
    for name in ("slope_um_per_hpa", "drift_um_per_s", "load_phase"):
        assert views.with_unit(name) == (name, ""), "a part of a name that is no unit of it"
    assert {views.label_of("load_phase"), views.label_of("phase")} == {"Load phase", "Phase, rad"}
    assert set(views.UNITS.values()) - {"hPa"} <= set(UNITS)


def broken_rules(xml: bytes) -> set[str]:
    """What PTB's Schematron rules of good practice find wrong, as the package dcclib carries them; without their warnings."""
    found = SchematronValidator.for_dcc().validate_str(xml.decode())
    of_both = [*found.failed_assertions, *found.successful_reports]
    return {" ".join(one.text.split()) for one in of_both if one.role == "error"}


def test_every_kind_keeps_ptb_s_rules_and_what_is_broken_does_not(place: Path) -> None:
    for kind, certificate in every_kind().items():
        assert broken_rules(dcc.to_xml(certificate)) == set(), kind
    assert b"not recorded with the measurement" in dcc.to_xml(every_kind()["circle"])
    assert "not recorded with the measurement" in str(blocks(every_kind()["circle"], "aa"))
    xml = dcc.to_xml(made())
    assert b"not recorded" not in xml
    for good, bad, said in (
        (b">DE<", b">XX<", "country"),
        (b">v", b">", "release"),
        (rb"\micro\metre", rb"\micro \metre", "unit"),
        (b'refType="basic_measuredValue hil_A"', b'id="A" refType="basic_measuredValue"', "refId"),
    ):
        assert good in xml
        assert any(said in rule for rule in broken_rules(xml.replace(good, bad, 1))), said


@pytest.mark.skipif(not SCHEMA, reason="HIL_DCC_SCHEMA names no folder with PTB's schema")
def test_every_kind_is_valid_against_ptb_s_schema_and_what_is_broken_is_not(place: Path) -> None:
    schema = xmlschema.XMLSchema(str(Path(SCHEMA) / "dcc.xsd"), allow="local")
    for certificate in every_kind().values():
        schema.validate(ET.fromstring(dcc.to_xml(certificate)))
    xml = dcc.to_xml(made())
    for part in (b"uniqueIdentifier", b"beginPerformanceDate", b"customer", b"performanceLocation"):
        cut = ET.fromstring(xml)
        for parent in cut.iter():
            for child in list(parent):
                if child.tag.endswith("}" + part.decode()):
                    parent.remove(child)
        assert not schema.is_valid(cut)
    assert not schema.is_valid(ET.fromstring(xml.replace(b">DE<", b">Germany<")))


@pytest.mark.outside
def test_two_campaigns_and_a_diagnosis_are_at_most_eight_sheets_and_open_with_the_sentence(place: Path) -> None:
    Path("before.csv").write_text(to_csv(rows(other_targets(), 4.0)))
    Path("found.json").write_text(json.dumps({"diagnosis": FOUND}))
    argv = ["before.csv", "verify.csv", "--diagnosis", "found.json", "--axis-file", "x.toml"]
    assert call(*argv, "--out", "r.html", "--pdf", "r.pdf") == 0
    sheets, words = text_of("r.pdf")
    assert sheets <= 8
    first_sentence = (
        "Found (± is U, k = 2, about 95 %): cyclic (period 10 ± 0.006 mm, amplitude 1.3 ± 0.08 µm, confidence 99.0 %)."
        " The error fell from"
    )
    assert words.index(first_sentence) < words.index("Accuracy A")


def test_a_report_needs_something_to_write(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call("verify.csv") == 2
    assert "nothing to write" in capsys.readouterr().err


def in_campaign(records: Records, folder: str, axis: str = "X", targets: list[float] | None = None, **more: Any) -> str:
    """Rows as a campaign leaves them: chained, with its purpose beside them."""
    purpose = {"axis": axis, "kind": "verify", "measurement": {"targets_mm": targets or []}, **more}
    campaign = Campaign(Path(folder), purpose, resume=False)
    with campaign.rows("verify", list(records.columns)) as journal:
        for values in zip(*(records[name] for name in records.columns), strict=True):
            journal.append(dict(zip(records.columns, map(float, values), strict=True)))
    return f"{folder}/verify.csv"


def test_rows_that_were_changed_or_are_of_another_axis_are_not_certified(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good = in_campaign(rows(other_targets()), "good")
    assert call(good, "--axis-file", "x.toml", "--dcc", "good.xml") == 0
    assert "lies outside" not in Path("good.xml").read_text()
    other = in_campaign(rows(other_targets()), "other", axis="Y")
    changed = Path(in_campaign(rows(other_targets()), "changed"))
    lines = changed.read_text().splitlines(keepends=True)
    changed.write_text("".join([*lines[:-1], lines[-1][:-2] + "7\n"]))
    for path, said in ((other, "was measured on axis Y"), (str(changed), "is not as it was written")):
        assert call(path, "--axis-file", "x.toml", "--dcc", "c.xml") == 2
        assert said in capsys.readouterr().err
        assert not Path("c.xml").exists()
    assert call("verify.csv", "--axis-file", "x.toml", "--dcc", "alone.xml") == 0
    assert "verify.csv lies outside its campaign" in Path("alone.xml").read_text()


def test_the_tables_targets_are_those_of_the_campaign_though_the_axis_file_has_changed(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    measured = in_campaign(rows(other_targets()), "own", targets=[float(one) for one in other_targets()])
    assert call(measured, "--axis-file", "x.toml", "--dcc", "c.xml") == 2
    assert "at the calibrated targets" in capsys.readouterr().err
    assert call(measured, "--axis-file", "x.toml", "--out", "r.html", "--json", "r.json") == 0
    found = json.loads(Path("r.json").read_text())["campaigns"][0]["accuracy"]
    assert (found["targets"], found["decision"]) == ("calibrated", "not judged")


def test_json_on_standard_output_and_the_status_beside_a_report(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    argv = ["verify.csv", "--axis-file", "x.toml", "--dcc", "c.xml"]
    assert call(*argv, "--json", "-") == 0
    assert json.loads(capsys.readouterr().out)["kind"] == "positioning"
    assert not Path("-").exists()
    assert call(*argv, "--limit", "0.1", "--out", "r.html") == 1


def test_only_the_files_that_were_evaluated_are_named(place: Path) -> None:
    Path("before.csv").write_text(Path("verify.csv").read_text())
    Path("my verify.csv").write_text(Path("verify.csv").read_text())
    assert call("before.csv", "my verify.csv", "--axis-file", "x.toml", "--dcc", "c.xml") == 0
    assert "before.csv" not in Path("c.xml").read_text()


def test_what_is_not_known_is_not_decided(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One direction has no A; without U the schema's conditional pass would claim more than is known."""
    both = rows(other_targets())
    up = NamedCampaign("up", both.where(both.direction == 1))
    told = positioning(common(limit_um=8.0), up).sentence
    assert "is not known; undecided against a limit of 8.00 µm" in told
    first, last = other_targets()[[0, -1]]
    assert f"from {first:g} to {last:g} mm" in told
    text = Path("x.toml").read_text()
    start, end = text.index("[uncertainty]"), text.index("[store]")
    Path("bare.toml").write_text(text[:start] + text[end:])
    assert call("verify.csv", "--axis-file", "bare.toml", "--dcc", "c.xml", "--limit", "100") == 0
    xml = Path("c.xml").read_text()
    assert "undecided" in xml
    assert "dcc:conformity>" not in xml


def test_a_loop_says_what_the_error_did_and_is_refused_where_nothing_was_measured_anew(place: Path) -> None:
    small, large = (NamedCampaign(name, rows(other_targets(), size)) for name, size in (("a", 1.0), ("b", 4.0)))
    assert "The error fell from" in opening(FOUND, large, small)
    assert "The error grew from" in opening({"findings": []}, small, large)
    assert "The error did not change: from" in opening(FOUND, small, small)
    own = NamedCampaign("own", rows(np.array(load_axis("x.toml").measurement.targets_mm)))
    with pytest.raises(InputError, match="the same rows"):
        loop(common(), small, NamedCampaign("again", small.records), FOUND)
    with pytest.raises(InputError, match="at the calibrated targets"):
        loop(common(), large, own, FOUND)


def test_a_parameter_of_a_user_s_effect_is_stated_only_with_its_unit(place: Path) -> None:
    size = {"value": 2.0, "std": 0.1}
    own = {"effect": "rack", "parameters": {"rate_nm_per_kg": size, "height_um": size}, "confidence": 0.9}
    air = {"effect": "air_index", "parameters": {"uncompensated_share": size}}
    before, after = (NamedCampaign(name, rows(other_targets(), um)) for name, um in (("before", 4.0), ("after", 1.0)))
    stated = loop(common(), before, after, {"findings": [own, air]}).stated
    assert [(one.symbol, one.unit) for one in stated[2:]] == [
        ("rack height_um", "µm"),
        ("rack confidence", "1"),
        ("air_index uncompensated_share", "1"),
    ]


def test_a_circle_of_other_axes_is_not_certified_for_this_one(place: Path) -> None:
    assert of_result(common(), {**circle_result(), "axes": ["X", "Y"]}).kind == "circle"
    with pytest.raises(InputError, match="driven with the axes Y, Z, and the axis file is of X"):
        of_result(common(), {**circle_result(), "axes": ["Y", "Z"]})


def test_without_a_file_it_is_of_the_latest_verification_and_says_so(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Not of one that was broken off, nor of another axis's in the same folder, and of none that is older than the tables."""

    def sentence(*argv: str) -> str:
        assert call(*argv, "--axis-file", "x.toml", "--dcc", "c.xml") == 0
        return capsys.readouterr().out

    assert call("--axis-file", "x.toml", "--dcc", "c.xml") == 2
    assert "holds no finished verification of the axis" in capsys.readouterr().err
    sizes = {1: 0.8, 2: 1.0, 9: 1.2, 10: 1.4}  # the tenth is later than the ninth
    files = {n: in_campaign(rows(other_targets(), size), f"campaign/verify-{n:03d}") for n, size in sizes.items()}
    in_campaign(rows(other_targets(), 4.0), "campaign/verify-011")
    in_campaign(rows(other_targets(), 5.0), "campaign/verify-012", axis="Y")
    for name in ("001", "002", "009", "010", "012"):
        (Path("campaign") / f"verify-{name}" / "finished").touch()
    named = sentence(files[10])
    assert "latest" not in named
    said = sentence()
    assert "of the latest verification, " in said
    assert said.splitlines()[-1] == named.splitlines()[-1]
    assert "verify-010/verify.csv" in Path("c.xml").read_text()
    old = sentence(files[1])
    assert "of verify-001/verify.csv as named; the latest verification is verify-010/verify.csv" in old
    assert old.splitlines()[-1] != named.splitlines()[-1]
    assert call("--axis-file", "x.toml", "--out", "r.html", "--json", "r.json") == 0
    assert json.loads(Path("r.json").read_text())["campaigns"][0]["source"] == "verify-010/verify.csv"

    capsys.readouterr()
    later = Path(in_campaign(rows(other_targets()), "campaign/calibrate-002", kind="calibrate"))
    (later.parent / "finished").touch()
    dated = re.sub(r"# begun \S+,", "# begun 2099-11-20T10:00:00+00:00,", later.read_text())
    later.write_text(dated)
    assert call("--axis-file", "x.toml", "--dcc", "c.xml") == 2
    assert "is older than calibrate-002" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("drive", "rows_of", "says"),
    [
        ('backend = "bench"\nmachine = "typical"\nseed = 3', {}, True),
        ('backend = "canopen"\nnode_id = 1\nsimulated = true', {}, True),  # as `hil sim drive` writes it
        ('backend = "modbus"\nregister_map = "vendor_style"\nurl = "tcp://127.0.0.1:502"\nsimulated = true', {}, True),
        ('backend = "canopen"\nnode_id = 1', {"drive": {"backend": "bench"}}, True),  # the rows say it themselves
        ('backend = "canopen"\nnode_id = 1', {"drive": {"backend": "canopen", "simulated": True}}, True),
        ('backend = "canopen"\nnode_id = 1', {"drive": {"backend": "canopen"}}, False),
    ],
)
def test_a_simulated_machine_is_one_in_title_sentence_and_xml(
    place: Path, capsys: pytest.CaptureFixture[str], drive: str, rows_of: dict[str, Any], says: bool
) -> None:
    text = Path("x.toml").read_text().replace('backend = "bench"\nmachine = "typical"\nseed = 3', drive)
    assert drive in text
    port = "" if "bench" in drive else '\nport = "/dev/ttyUSB0"'
    Path("x.toml").write_text(text.replace('kind = "umd"', f'kind = "umd"{port}'))
    measured = in_campaign(rows(other_targets()), "campaign/verify-001", **rows_of)
    assert call(measured, "--axis-file", "x.toml", "--dcc", "c.xml") == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith("Of a simulated machine. ") == says
    xml = ET.fromstring(Path("c.xml").read_bytes())
    ns = {"d": dcc.DCC}
    title = xml.findtext(".//d:measurementResult/d:name/d:content", "", ns)
    assert title == ("SIMULATED MACHINE: " if says else "") + "Positioning of axis X"
    assert (xml.find(".//d:statement[@refType='hil_simulated']", ns) is not None) == says


def test_the_place_a_line_to_sign_and_what_the_standard_asks_for_beyond_stand_on_it(place: Path) -> None:
    few = positioning(common(limit_um=20.0), NamedCampaign("verify", rows(other_targets(), runs=3)))
    asked = "3 runs per direction; the standard asks for five on axes up to 2 m"
    assert few.sentence.endswith(f"limit of 20.00 µm: pass ({asked}).")
    shown = str(blocks(few, "aa"))
    assert f"Tile(name='Verdict', value='pass', unit='', below='{asked}'" in shown
    assert "'Place': 'customer: Example Works, Jena, DE'" in shown
    assert "Signature of A. Builder" in shown
    at_home = dataclasses.replace(few.config, place="laboratory")
    assert "'Place': 'laboratory: Example Metrology, Braunschweig, DE" in str(
        blocks(dataclasses.replace(few, config=at_home), "aa")
    )
    assert "standard asks" not in made().sentence


@pytest.mark.parametrize(
    ("option", "name", "kind"),
    [
        ("--certificate", "c.html", ".pdf"),
        ("--dcc", "c.pdf", ".xml"),
        ("--pdf", "r", ".pdf"),
        ("--certificate", "c.xml", ".pdf"),
    ],
)
def test_no_file_is_written_under_the_name_of_another_kind(
    place: Path, capsys: pytest.CaptureFixture[str], option: str, name: str, kind: str
) -> None:
    with pytest.raises(SystemExit, match="2"):
        call("verify.csv", "--axis-file", "x.toml", "--out", "r.html", option, name)
    assert f"argument {option}: is '{name}', expected a name ending in {kind}" in capsys.readouterr().err
    assert not Path(name).exists()
