"""The grammar study runs the public verbs on its machines and reports shares with the seeds they come from."""

import json

import pytest
from study.grammar.__main__ import main
from study.grammar.machine import SEEDS


@pytest.mark.slow
def test_a_strong_cause_and_a_clean_machine_are_judged_by_what_the_verbs_say(tmp_path, capsys):
    out = tmp_path / "study.json"
    assert main(["--lot", "strong", "--lot", "clean", "--machines", "2", "--processes", "1", "--json", str(out)]) == 0
    found = json.loads(out.read_text())
    first = SEEDS["tuning"][0]
    assert found["seeds"] == f"tuning seeds {first} to {first + 1} (2)"
    assert [one["seed"] for one in found["outcomes"]] == [first, first + 1] * 2
    assert not any("error" in one for one in found["outcomes"])
    assert found["lots"]["strong"]["named first"]["of"] == 2
    for one in found["outcomes"]:  # noise alone is the least that anything can leave
        assert one["fresh_true_um"] == pytest.approx(one["fresh_noise_um"], rel=0.25)
        assert one["fresh_um"] > 0.9 * one["fresh_true_um"]
    assert found["seeds"] in capsys.readouterr().out
    again = tmp_path / "again.json"
    assert main(["--together", str(out), "--json", str(again)]) == 0
    assert json.loads(again.read_text()) == found
