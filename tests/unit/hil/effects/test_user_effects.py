"""What happens to a user's own effects: which are taken, which are refused in one line, and that nothing but the user names them."""

from __future__ import annotations

import json
import sys
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from contract import test_effects as suite
from support import bench_axis

import hil.examples.coolant_level as example
from drivers.errors import InputError
from hil.app.main import main
from hil.axis.axis_file import load_axis
from hil.correction.compensation import Compensation
from hil.correction.store import SealedStore
from hil.correction.tables import DirectionalTable, TableMode, TableSet
from hil.effects import ALL, Form, Term, survey_of
from hil.effects.history import complete
from hil.effects.user_effects import attributing_errors, catalogue_with, check_on, effects_of_file

OWN = Path(example.__file__)
TEXT = OWN.read_text(encoding="utf-8")
RECORDS = "run,direction,target_mm,measured_mm,coolant_level_mm\n" + "".join(
    f"{run},{d:+d},{10 * p},{10 * p + 0.001 * run * d},{100 + p * run}\n"
    for run in (1, 2)
    for d in (1, -1)
    for p in range(4)
)


def own(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "own.py"
    path.write_text(text)
    return path


def test_a_file_stands_beside_the_catalogue_and_changes_nothing_else() -> None:
    before = ALL
    effects = catalogue_with([OWN])
    assert effects[: len(ALL)] == ALL
    assert [effect.id for effect in effects[len(ALL) :]] == ["coolant_level"]
    assert before is ALL
    assert [effect.id for effect in catalogue_with()] == [effect.id for effect in ALL]


def test_a_file_may_hold_dataclasses_and_be_loaded_again(tmp_path: Path) -> None:
    """A dataclass looks for its module among those that are loaded."""
    text = "from __future__ import annotations\n" + TEXT.partition('"""\n\n')[2]
    text += "\nfrom dataclasses import dataclass\n\n@dataclass\nclass Tank:\n    volume_l: float = 3.0\n"
    path = own(tmp_path, text)
    for _ in range(2):
        assert [effect.id for effect in effects_of_file(path)] == ["coolant_level"]


BROKEN = {
    "not Python": ("class (:\n", ":1: fails when loaded: SyntaxError"),
    "an import that is not there": (
        "x = 1\nimport no_such_thing_at_all\n",
        ":2: fails when loaded: ModuleNotFoundError",
    ),
    "ends the program": ("import sys\n\nsys.exit(0)\n", ":3: fails when loaded: SystemExit"),
    "no EFFECTS": ("x = 1\n", ": holds no EFFECTS; expected EFFECTS = (MyEffect(), …)"),
    "no effect in EFFECTS": ("EFFECTS = ()\n", ": holds no effect; expected"),
    "not an effect": ("EFFECTS = (3,)\n", ": offers 3 as an effect; expected a hil.effects.Effect"),
    "the class": (TEXT.replace("(CoolantLevel(),)", "(CoolantLevel,)"), "expected an object: CoolantLevel()"),
    "a method is missing": (
        TEXT.replace("def explain", "def explains"),
        "Can't instantiate abstract class CoolantLevel",
    ),
    "an id of the catalogue": (
        TEXT.replace('"coolant_level"', '"cyclic"'),
        "'cyclic', which the catalogue has already",
    ),
    "the same id twice": (
        TEXT.replace("(CoolantLevel(),)", "(CoolantLevel(), CoolantLevel())"),
        "'coolant_level', which",
    ),
    "an id with spaces": (TEXT.replace('"coolant_level"', '"Coolant level"'), "id is 'Coolant level', expected small"),
    "no title": (TEXT.replace("    title: ", "    name: "), "title is None, expected str"),
    "a rival by its name": (
        TEXT.replace(
            "    rivals: ClassVar[tuple[Rival, ...]] = (\n",
            "    rivals: ClassVar[tuple[Rival, ...]] = (\n        'abbe',\n",
        ),
        "rivals holds something else than Rival",
    ),
    "an action of its own": (
        TEXT.replace("Action.COMPENSATE", '"compensate"'),
        "action is 'compensate', expected Action",
    ),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_file_that_cannot_be_used_is_refused_in_one_line(
    case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text, expected = BROKEN[case]
    path, records = own(tmp_path, text), tmp_path / "records.csv"
    records.write_text(RECORDS)
    assert main(["diagnose", str(records), "--effects", str(path)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith(f"hil: {path}")
    assert captured.err.count("\n") == 1
    assert expected in captured.err


def test_every_verb_that_uses_effects_takes_the_file_before_anything_moves(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    axis, records = bench_axis.lay_out(tmp_path), tmp_path / "records.csv"
    records.write_text(RECORDS)
    path = own(tmp_path, "EFFECTS = ()")
    for verb in (
        ["diagnose", str(records)],
        ["fit", str(records), "--out", "x"],
        ["apply", "--model", "x", str(records), "--out", "y"],
        ["campaign", "check", str(records)],
        ["close-loop", str(axis), "--dry-run"],
    ):
        assert main([*verb, "--effects", str(path)]) == 2
        assert capsys.readouterr().err == f"hil: {path}: holds no effect; expected EFFECTS = (MyEffect(), …)\n"
    assert main(["close-loop", str(axis), "--dry-run", "--effects", str(OWN)]) == 0


def test_a_file_that_is_not_there_and_one_that_is_no_python_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"gone\.py: is no file"):
        effects_of_file(tmp_path / "gone.py")
    text = tmp_path / "effects.txt"
    text.write_text("EFFECTS = ()")
    with pytest.raises(InputError, match=r"effects\.txt: is no Python"):
        effects_of_file(text)


RAISING = {
    "level = columns[LEVEL]": ("level = 1 / 0 * columns[LEVEL]", "fails: ZeroDivisionError: division by zero"),
    "return level[:, None]": ("return level", r"form 'offset', has a basis of shape (16,), expected (16, k)"),
    "return np.asarray(level * u)[:, None]": ("return np.full((len(u), 1), np.nan)", "has a basis that is not finite"),
    "survey.mean[LEVEL]": ('survey.mean["gone"]', "fails: KeyError: 'gone'"),
}


@pytest.mark.parametrize("place", RAISING)
def test_an_effect_that_fails_on_the_records_is_named_by_its_file(
    place: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    instead, expected = RAISING[place]
    assert TEXT.count(place) == 1
    path, records = own(tmp_path, TEXT.replace(place, instead)), tmp_path / "records.csv"
    records.write_text(RECORDS)
    assert main(["diagnose", str(records), "--effects", str(path)]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"hil: {path}")
    assert error.count("\n") == 1
    assert expected in error


def test_one_row_without_a_number_is_enough_and_none_is_none(tmp_path: Path) -> None:
    columns = {name: np.arange(4.0) for name in ("run", "target_mm", "measured_mm", "coolant_level_mm")}
    columns |= {"direction": np.ones(4)}
    assert check_on(catalogue_with([OWN]), columns) is None
    text = TEXT.replace("return np.asarray(level * u)[:, None]", "return np.where(u < 1, level * u, np.nan)[:, None]")
    assert text != TEXT
    with pytest.raises(
        InputError, match=r"own\.py: effect coolant_level, form 'with position', has a basis that is not f"
    ):
        check_on(catalogue_with([own(tmp_path, text)]), columns)


def test_only_what_comes_out_of_the_users_file_is_blamed_on_it() -> None:
    effects = catalogue_with([OWN])
    with pytest.raises(ZeroDivisionError), attributing_errors(effects):
        print(1 / 0)
    columns = {name: np.arange(3.0) for name in ("target_mm", "measured_mm", "coolant_level_mm")}
    form = effects[-1].forms(survey_of(complete(columns | {"run": np.ones(3), "direction": np.ones(3)})))[0]
    with pytest.raises(InputError, match=r"coolant_level\.py:\d+: fails: KeyError"), attributing_errors(effects):
        effects[-1].basis(form, (), {"target_mm": np.ones(3)})


def test_an_effect_whose_columns_are_not_there_is_nothing_to_complain_about() -> None:
    columns = {name: np.arange(4.0) for name in ("run", "target_mm", "measured_mm")} | {"direction": np.ones(4)}
    assert check_on(catalogue_with([OWN]), columns) is None


@pytest.mark.usefixtures("passwords")
def test_a_sealed_store_that_holds_one_is_read_with_its_file_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = bench_axis.lay_out(tmp_path)
    form = Form("coolant_level", "offset", ("coolant_level_mm",), {"mean_mm": 100.0})
    term = Term(catalogue_with([OWN])[-1], form, (), (0.25,), ((0.01,),))
    tables = TableSet(TableMode.BIDIRECTIONAL, DirectionalTable.constant(np.array([0.0, 100.0]), 1.0))
    store = SealedStore.of(load_axis(path), *bench_axis.PASSWORDS.values())
    store.save(Compensation(tables, (term,)))
    loaded = store.load(catalogue_with([OWN]))
    known = {"target_mm": np.array([50.0]), "direction": np.array([1.0]), "coolant_level_mm": np.array([104.0])}
    assert loaded.correction_um(known) == pytest.approx([1.0 - 0.25 * 4.0])
    assert main(["verify", str(path)]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"hil: {store.path}: X.effects[0] names the effect 'coolant_level', which is not loaded; ")
    assert error.count("\n") == 1
    assert "--effects FILE.py" in error
    verb = ["export", str(path), "--format", "linuxcnc", "--out", str(tmp_path / "x")]
    assert main([*verb, "--effects", str(OWN)]) == 2
    assert "what is in force holds coolant_level, and" in capsys.readouterr().err


FAULTS = {
    "looks at the rows to come": (
        'level = columns[LEVEL] - form.constants["mean_mm"]',
        "level = columns[LEVEL] - np.mean(columns[LEVEL])",
        "test_it_reads_only_what_it_says_and_only_the_past",
    ),
    "reads what it does not name": (
        'Form(self.id, "with position", (LEVEL, "target_mm"), constants)',
        'Form(self.id, "with position", (LEVEL,), constants)',
        "test_it_reads_only_what_it_says_and_only_the_past",
    ),
    "grows without end": (
        "return level[:, None]",
        "return np.exp(1e3 * level)[:, None]",
        "test_its_basis_is_finite_and_of_one_width_over_its_whole_grid",
    ),
    "names no figure": (
        "moves the table by {term.coefficient(0)} µm {where}.",
        "moves the table {where}.",
        "test_it_survives_the_model_file_and_says_what_it_is",
    ),
    "names no column": (
        "COLUMNS = {LEVEL: 120.0}",
        "COLUMNS = {}",
        "test_it_shows_in_a_rich_campaign_and_names_its_rivals",
    ),
}


@pytest.mark.filterwarnings("ignore:overflow encountered")
@pytest.mark.parametrize("fault", FAULTS)
def test_the_contract_suite_finds_what_is_wrong_with_a_file(fault: str, tmp_path: Path) -> None:
    right, wrong, check = FAULTS[fault]
    assert TEXT.count(right) == 1
    for text, good in ((TEXT, True), (TEXT.replace(right, wrong), False)):
        (subject,) = suite.subjects([str(own(tmp_path, text))])
        arguments = [(subject, form) for form in subject.effect.forms(subject.survey)]
        if check == "test_it_shows_in_a_rich_campaign_and_names_its_rivals":
            arguments = [(subject,)]
        with nullcontext() if good else pytest.raises((AssertionError, KeyError)):
            for each in arguments:
                getattr(suite, check)(*each)


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package in the path whose entry point brings the effect."""
    place = tmp_path / "site"
    info = place / "coolant_effects-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: coolant-effects\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[hil.effects]\ncoolant = coolant_effects:EFFECTS\n")
    (place / "coolant_effects.py").write_text(TEXT)
    monkeypatch.syspath_prepend(place)
    monkeypatch.delitem(sys.modules, "coolant_effects", raising=False)
    return place


def test_an_installed_package_brings_its_effects_by_an_entry_point(installed: Path) -> None:
    assert [effect.id for effect in catalogue_with()][len(ALL) :] == ["coolant_level"]
    with pytest.raises(InputError, match=r"which package coolant-effects \(entry point coolant\) has already"):
        catalogue_with([OWN])


def test_a_package_that_cannot_be_used_is_named(installed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (installed / "coolant_effects.py").write_text("EFFECTS = 3\n")
    records = installed / "records.csv"
    records.write_text(RECORDS)
    assert main(["diagnose", str(records)]) == 2
    error = capsys.readouterr().err
    assert error == (
        "hil: package coolant-effects (entry point coolant): offers 3 as an effect; expected a hil.effects.Effect\n"
    )


def test_no_file_of_data_can_name_code(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Records, a model and an axis file that name a Python file or a module: refused, or no more than a name; nothing runs."""
    marker = tmp_path / "it_ran"
    path = own(tmp_path, f"open({str(marker)!r}, 'w').close()\n" + TEXT.partition('"""\n\n')[2])
    records, model = tmp_path / "records.csv", tmp_path / "model.json"
    records.write_text(RECORDS.replace("run,", f"# effects: {path}\nrun,", 1))
    assert main(["fit", str(records), "--out", str(model)]) == 0
    plain = json.loads(model.read_text())
    term = {
        "effect": str(path), "form": "offset", "inputs": [], "constants": {}, "nonlinear": {}, "coefficients": [],
        "covariance": [],
    }  # fmt: skip
    for change in ({"effects": [str(path)]}, {"terms": [term]}, {"terms": [term | {"effect": "own:CoolantLevel"}]}):
        model.write_text(json.dumps(plain | change))
        capsys.readouterr()
        assert main(["apply", "--model", str(model), str(records), "--out", str(tmp_path / "out.csv")]) == 2
        assert capsys.readouterr().err.startswith(f"hil: {model}: ")
    axis = tmp_path / "axis.toml"
    axis.write_text((OWN.parent / "axis.toml").read_text() + f'\n[diagnosis]\neffects = ["{path}"]\n')
    with pytest.raises(InputError, match="diagnosis"):
        load_axis(axis)
    assert not marker.exists()
    effects_of_file(path)
    assert marker.exists()  # the file does what it should when a user does name it
