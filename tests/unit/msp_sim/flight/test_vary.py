"""What varies from flight to flight: values follow their distributions, and a seed and a number give a flight."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.random import default_rng

from msp_range.yaml_file import ConfigError, with_value
from msp_sim.flight.sampled import Sampled
from msp_sim.flight.scenario import load_scenario
from msp_sim.flight.vary import Choice, Factor, LogUniform, RandomFaults, TruncatedNormal, Uniform, places

CONTENT: dict[str, Any] = {
    "name": "short",
    "airframe": str(Path(__file__).parents[4] / "configs" / "quad_pallet.yaml"),
    "duration_s": 9,
    "flight": {"altitude": [{"kind": "climb", "to_m": 1.0}, {"kind": "hold", "duration_s": 2}, {"kind": "land"}]},
}


def sampled(folder: Path, vary: dict[str, Any] | None, **changed: Any) -> Sampled:
    """The flights of a short scenario with this section."""
    path = folder / "short.yaml"
    section = {} if vary is None else {"vary": vary}
    path.write_text(yaml.safe_dump({**CONTENT, **changed, **section}), encoding="utf-8")
    return Sampled(load_scenario(path), "short.yaml")


def uniform(low: float, high: float) -> dict[str, Any]:
    return {"kind": "uniform", "low": low, "high": high}


def test_values_follow_their_distributions() -> None:
    generator = default_rng(1)

    def many(distribution: Any) -> Any:
        return np.array([distribution.draw(generator) for _ in range(4000)])

    even = many(Uniform(kind="uniform", low=-2.0, high=4.0))
    assert -2.0 <= even.min() < -1.95
    assert 3.95 < even.max() <= 4.0
    assert even.mean() == pytest.approx(1.0, abs=0.15)
    for drawn in (many(LogUniform(kind="log_uniform", low=1.0, high=4.0)), many(Factor(kind="factor", low=1, high=4))):
        assert 1.0 <= drawn.min() <= drawn.max() <= 4.0
        assert np.mean(drawn < 2.0) == pytest.approx(0.5, abs=0.04)
    normal = many(TruncatedNormal(kind="normal", mean=5.0, std=2.0, low=5.0))
    assert normal.min() >= 5.0
    assert normal.mean() == pytest.approx(5.0 + 2.0 * 0.7979, abs=0.1)
    words = many(Choice(kind="choice", of=("grass", "grass", "sand")))
    assert np.mean(words == "grass") == pytest.approx(2 / 3, abs=0.04)


def test_faults_come_as_often_and_as_long_as_the_section_says() -> None:
    faults = RandomFaults(share=0.25, most=3, kinds=("silent", "locked_up"), shortest_s=2.0, longest_s=8.0)
    kinds = {"left": ("silent",), "right": ("silent", "locked_up")}
    generator = default_rng(1)
    drawn = [faults.draw(generator, kinds, 60.0) for _ in range(4000)]
    some = [each for each in drawn if each]
    assert len(some) / len(drawn) == pytest.approx(0.25, abs=0.03)
    assert np.bincount([len(each) for each in some], minlength=4)[1:] / len(some) == pytest.approx(
        [1 / 3] * 3, abs=0.06
    )
    flat = [fault for each in some for fault in each]
    assert {(fault["sensor"], fault["kind"]) for fault in flat} == {
        ("left", "silent"),
        ("right", "silent"),
        ("right", "locked_up"),
    }
    lengths_s = np.array([fault["to_s"] - fault["from_s"] for fault in flat])
    assert lengths_s.min() > 1.99
    assert lengths_s.max() < 8.01
    assert np.mean(lengths_s < 4.0) == pytest.approx(0.5, abs=0.05)


def test_a_seed_and_a_number_give_a_flight(tmp_path: Path) -> None:
    flights = sampled(tmp_path, {"parameters": {"air.ground_c": uniform(0, 30)}, "faults": {"share": 1.0}})
    first, again, other = flights.sample(1, 7), flights.sample(1, 7), flights.sample(1, 8)
    assert first == again
    assert first.scenario.air.ground_c == first.values["air.ground_c"] != other.values["air.ground_c"]
    assert first.seed != other.seed
    assert first.scenario.faults
    assert [each.model_dump(exclude_defaults=True) for each in first.scenario.faults] == [
        {key: value for key, value in each.items() if value != 1.0 or key != "probability"} for each in first.faults
    ]
    assert flights.sample(2, 7).values != first.values


def test_factors_change_each_element_of_a_list_alike(tmp_path: Path) -> None:
    legs = [{"duration_s": 1, "speed_m_s": 0.1}, {"duration_s": 1, "speed_m_s": 0.2}]
    flight = {**CONTENT["flight"], "track": {"legs": legs}}
    factor = {"kind": "factor", "low": 0.5, "high": 2.0}
    drawn = sampled(tmp_path, {"parameters": {"flight.track.legs[*].speed_m_s": factor}}, flight=flight).sample(1, 0)
    slow, fast = (leg.speed_m_s for leg in drawn.scenario.flight.track.legs)
    assert (slow, fast) == pytest.approx(
        (0.1 * drawn.values["flight.track.legs[*].speed_m_s"], 0.2 * drawn.values["flight.track.legs[*].speed_m_s"])
    )
    assert slow != 0.1


def test_what_is_not_in_the_file_gets_its_default_around_the_draw(tmp_path: Path) -> None:
    drawn = sampled(tmp_path, {"parameters": {"flight.attitude.sway.roll_rms_deg": uniform(2, 3)}}).sample(1, 0)
    sway = drawn.scenario.flight.attitude.sway
    assert sway is not None
    assert 2.0 <= sway.roll_rms_deg <= 3.0
    assert sway.pitch_rms_deg == 1.0


def test_draws_that_cannot_be_flown_are_drawn_again_and_counted(tmp_path: Path) -> None:
    heights = {"parameters": {"flight.altitude[0].to_m": uniform(-0.5, 1.0)}}
    flights = sampled(tmp_path, heights)
    drawn = [flights.sample(1, number) for number in range(12)]
    assert all(each.values["flight.altitude[0].to_m"] > -0.01 for each in drawn)
    assert sum(each.refused for each in drawn) > 0
    below = sampled(tmp_path, {"parameters": {"flight.altitude[0].to_m": uniform(-2.0, -1.0)}})
    with pytest.raises(ConfigError, match="none of 100 draws can be flown; the last one: flight: at"):
        below.sample(1, 0)


def test_without_the_section_terrain_motion_temperatures_and_faults_vary(tmp_path: Path) -> None:
    flights = sampled(tmp_path, None)
    assert flights.vary.faults is not None
    kinds = {path.split(".")[0] for path in flights.vary.parameters}
    assert kinds == {"ground", "flight", "air", "thermometer"}
    assert flights.sample(1, 0).scenario.ground.rough["grass"].rms_m < 0.05


@pytest.mark.parametrize(
    ("vary", "expected"),
    [
        ({"air.grund_c": uniform(0, 1)}, "vary.parameters: air.grund_c: unknown key. Did you mean 'ground_c'"),
        ({"sky.ground_c": uniform(0, 1)}, "vary.parameters: sky: unknown key"),
        ({"air.ground_c": uniform(0, 90)}, "vary.parameters: air.ground_c: found 90.0; expected"),
        ({"flight.altitude[3].to_m": uniform(0, 1)}, "3 is not an element of the list, which has 3"),
        ({"flight.track.legs[*].speed_m_s": uniform(0, 1)}, "the list has no elements"),
        ({"air[0].ground_c": uniform(0, 1)}, "0 stands behind what is not a list"),
        ({"air ground": uniform(0, 1)}, "expected the path of a parameter, such as air.ground_c"),
        (
            {"ground.surface": {"kind": "factor", "low": 1, "high": 2}},
            "found 'grass' in the scenario; expected a number",
        ),
        ({"air.ground_c": uniform(3, 1)}, "expected the second to be larger"),
        ({"air.ground_c": {"kind": "unform", "low": 0, "high": 1}}, "expected one of uniform, log_uniform"),
        ({"air.ground_c": {"kind": "normal", "mean": 0, "std": 1, "low": 5}}, "wrong side of the mean"),
    ],
)
def test_what_cannot_vary_is_named(tmp_path: Path, vary: dict[str, Any], expected: str) -> None:
    with pytest.raises(ConfigError) as found:
        sampled(tmp_path, {"parameters": vary})
    assert expected in str(found.value)


def test_unknown_faults_are_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="found 'sleepy'; expected some of clock_fault"):
        sampled(tmp_path, {"faults": {"kinds": ["sleepy"]}})


@pytest.mark.parametrize("change", [lambda values: places(values, "a[*].b"), lambda values: places(values, "a[1].b")])
def test_values_are_changed_in_a_copy(change: Callable[[dict[str, Any]], Any]) -> None:
    values: dict[str, Any] = {"a": [{"b": 1}, {"b": 2}], "c": 3}
    changed = values
    for place in change(values):
        changed = with_value(changed, place, 9)
    assert changed["a"][1] == {"b": 9}
    assert changed["c"] == 3
    assert values == {"a": [{"b": 1}, {"b": 2}], "c": 3}
