"""The demonstration of the gap workflow: flights with five effects, all found, and a model that flies."""

import subprocess
from pathlib import Path

import pytest

from msp_lab.gap import demo
from msp_lab.gap.findings import FittedValue
from msp_lab.gap.findings_file import read_findings
from msp_range.yaml_file import ConfigError
from tests.docs.runner import clone
from tests.docs.shown import shown


@pytest.mark.slow
def test_all_hidden_effects_are_named_and_the_extended_model_flies(tmp_path: Path) -> None:
    place = clone(tmp_path)
    subprocess.run(shown("make gap-demo").split(), cwd=place, check=True, timeout=600.0)
    made = place / "flights/gap-demo"
    findings = read_findings(made / "gap")
    found = list(demo.comparisons(findings))
    assert {each.effect for each in found if each.found is not None} == {each["name"] for each in demo.HIDDEN}
    assert sum(each.holds for each in found) >= len(found) - 1, found
    assert {each.name for each in findings.effects} == {each["name"] for each in demo.HIDDEN}
    assert not findings.unknown
    assert findings.gap is not None
    assert findings.gap.nats_per_reading.after is not None
    assert findings.gap.nats_per_reading.after < 0.01 * (findings.gap.nats_per_reading.before or 0.0)
    assert (made / "gap/report.html").exists()
    assert (made / "flight-8.mcap").stat().st_size > 10_000


def test_an_earlier_demonstration_is_replaced_only_when_asked(tmp_path: Path) -> None:
    demo.clear(tmp_path, force=False)
    (tmp_path / "flight-0.mcap").write_bytes(b"")
    with pytest.raises(ConfigError, match="--force"):
        demo.clear(tmp_path, force=False)
    demo.clear(tmp_path, force=True)
    assert not list(tmp_path.iterdir())


def test_what_was_not_named_is_reported_so() -> None:
    assert not demo.HiddenNumber("rotor_noise", "growth", 3.0, None).holds
    assert not demo.HiddenNumber("rotor_noise", "growth", 3.0, FittedValue(2.0, 1.0, 2.9, "1")).holds
    assert demo.HiddenNumber("rotor_noise", "growth", 3.0, FittedValue(2.0, 1.0, 3.1, "1")).holds
