"""Exchanged sensors on serial ports, whose addresses are words."""

from pathlib import Path

from msp_range.commission.edit import as_yaml
from msp_range.commission.steps.addresses import compare
from msp_range.config import load_airframe
from tests.support.shipped import CONFIGS


def test_two_serial_sensors_that_are_exchanged_get_each_others_port(tmp_path: Path) -> None:
    text = (CONFIGS / "serial_down.yaml").read_text().replace("sensors/", f"{CONFIGS}/sensors/")
    (line,) = [each for each in text.splitlines() if "name: down," in each]
    pairs = (("name: down, id: 1,", "name: {}, id: {},"), ("port0:9600", "port{1}:9600"))
    both = []
    for number, name in enumerate("ab", 1):
        made = line
        for old, new in pairs:
            made = made.replace(old, new.format(name, number))
        both.append(made)
    path = tmp_path / "airframe.yaml"
    path.write_text(text.replace(line, "\n".join(both)))
    airframe = load_airframe(path)
    ports = [as_yaml(sensor.address) for sensor in airframe.sensors]
    (proposal,) = compare(airframe, {"a": "b", "b": "a"}).proposals
    assert [as_yaml(edit.value) for edit in proposal.edits] == ports[::-1]
    assert "port1:9600" in proposal.text
