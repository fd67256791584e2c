"""Effects of a user's own file: what check-effect reports of user errors in them, and which files are refused."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from msp_lab.cli import app
from msp_range.yaml_file import ConfigError
from msp_sim.effects import CATALOGUE
from msp_sim.effects.own import add_own_effects, effects_of_file, find_effect

EXAMPLE = Path(__file__).parents[3] / "third_party" / "package" / "sonar_extras" / "supply_sag.py"
ACT = 'return Contribution(bias_cm=-values["sag_pct"] / 100.0 * scene["throttle"] * scene.range_cm)'
NORMAL = """
from msp_sim.effects.component import Normal
class Own(Normal):
    def take(self, rows):
        return self

    def {}
"""
COMPONENT = "return Contribution(component=Own(100.0, 5.0, {}), share=np.maximum(values['sag_pct'], 0.0) / 40.0)"


def check(path: Path, code: int) -> str:
    result = CliRunner().invoke(app, ["check-effect", str(path)])
    assert result.exit_code == code, result.output
    return result.output


def failed(output: str) -> list[str]:
    return [line.removeprefix("  FAILED ") for line in output.splitlines() if line.startswith("  FAILED ")]


def test_an_effect_that_keeps_the_contract_passes() -> None:
    output = check(EXAMPLE, 0)
    assert output.startswith("supply_sag: With more throttle the supply sags")
    assert output.count("  ok ") == len(output.splitlines()) - 1 >= 10


def test_an_effect_that_the_catalogue_nearly_has_is_named(tmp_path: Path) -> None:
    """Of ranges that are too short by a share, whatever the throttle: two of the catalogue do that."""
    path = tmp_path / "own.py"
    text = EXAMPLE.read_text(encoding="utf-8").replace(' * scene["throttle"]', "")
    path.write_text(text.replace('("throttle", "true_range_cm")', '("true_range_cm",)'))
    notes = {line for line in check(path, 0).splitlines() if line.startswith("  note: ")}
    nearly = "  note: it is nearly {} of the catalogue, which explains 100 % of what it does"
    assert notes == {nearly.format("range_scale"), nearly.format("bend")}


@pytest.mark.parametrize(
    ("before", "after", "title", "found"),
    [
        ('channels=("bias",)', 'channels=("bias")', "it is described", "channels is a text"),
        ("at two ranges", "at two ranges.", "it is described", "ends with a full stop"),
        ('"supply_sag"', '"Supply sag"', "it is described", "the name is 'Supply sag'"),
        ("{sag_pct:too short|too long}", "{sag}", "it is described", "cannot be filled in: 'sag'"),
        ("{sag_pct:too short|too long}", "{sag_pct:loud}", "it is described", "no such format: 'loud'"),
        ("-20.0, 20.0)", "1.0, 20.0)", "it is described", "sag_pct: 0 is outside its bounds 1 to 20"),
        ('channels=("bias",)', 'channels=("spread",)', "it runs", "it changes bias, but says spread"),
        ('values["sag_pct"]', 'values["sag"]', "it runs", "it raises KeyError: 'sag'"),
        (ACT, "return Contribution(bias_cm=0.0 * scene.range_cm)", "it is visible", "its own readings 0 nats better"),
        (ACT, ACT[:-1] + " + 1.0)", "at its neutral values it does nothing", "of 3000 readings differ"),
        ('("throttle", "true', '("true_range_cm", "true', "it runs", "it raises KeyError: 'throttle'"),
        (ACT, COMPONENT.format("False"), "draws follow the probabilities", "do not follow it (p = "),
        (ACT, COMPONENT.format("True"), "slopes are the derivatives of the probabilities", "slope by "),
        (
            ACT,
            'return Contribution(bias_cm=-values["sag_pct"] * scene["throttle"].clip(0.0, 1.0))',
            "a single reading is drawn like many",
            "has no attribute 'clip'",
        ),
        (
            ACT,
            'return Contribution(bias_cm=values["sag_pct"] * np.mean(scene["throttle"] > 0.5))',
            "a reading depends on its own context only",
            "of 600 probabilities depend on the other readings",
        ),
    ],
)
def test_a_user_error_is_found_and_explained(before: str, after: str, title: str, found: str, tmp_path: Path) -> None:
    text = "import numpy as np\n" + EXAMPLE.read_text(encoding="utf-8")
    assert before in text
    own = "sample(self, rng, hits):\n        return super().sample(rng, hits) + 3.0"
    if "True" in after:
        own = "prob(self, *given, slopes=False):\n        p = super().prob(*given, slopes=slopes)\n"
        own += "        return p * np.array([[1.0], [2.0], [1.0]]) if slopes else p"
    if "Own" in after:
        text = text.replace("\n\n\ndef _apply", NORMAL.format(own) + "\n\ndef _apply")
        text = text.replace('channels=("bias",)', 'channels=("component",)')
    path = tmp_path / "own.py"
    path.write_text(text.replace(before, after), encoding="utf-8")
    output = check(path, 1)
    assert any(line.startswith(title) for line in failed(output)), output
    assert found in output
    assert "to do: " in output


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "own.py: no such file"),
        ("import numpy as np\n", "own.py: found no effect"),
        ("from msp_sim.effects.bend import BEND\n", "own.py: found no effect"),
        ("a = 1\nb = a / 0\n", r"own.py:2: ZeroDivisionError: division by zero"),
        ("a = 1\nb = (\n", r"own.py:2: SyntaxError: "),
        ("import not_there\n", r"own.py:1: ModuleNotFoundError: No module named 'not_there'"),
    ],
)
def test_a_file_that_cannot_be_used_is_a_line(text: str | None, message: str, tmp_path: Path) -> None:
    path = tmp_path / "own.py"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=message):
        effects_of_file(path)


def test_an_effect_with_the_name_of_another_one_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "own.py"
    path.write_text(EXAMPLE.read_text(encoding="utf-8").replace('"supply_sag"', '"bend"'), encoding="utf-8")
    before = dict(CATALOGUE)
    with pytest.raises(ConfigError, match=r"own.py: the effect 'bend' has the name of one of the catalogue"):
        add_own_effects([path])
    assert before == CATALOGUE
    assert find_effect("supply_sag") is None
