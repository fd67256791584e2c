"""Effect: the echo is detected some periods late."""

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values, share_of_readings
from msp_sim.effects.component import Normal


def _apply(scene: Scene, values: Values) -> Contribution:
    half_wavelength_cm = 100.0 * scene.assumed_m_s / scene.sensor.frequency_hz / 2.0
    slip_cm = values["cycles"] * half_wavelength_cm
    return Contribution(component=Normal(slip_cm, from_hit=True), share=values["share"])


CYCLE_SLIP = Effect(
    name="cycle_slip",
    sentence="Now and then the first waves of an echo are missed, and the reading jumps by whole wavelengths.",
    finding="{share:of} readings miss {cycles:number} waves of their echo",
    physics="hits later by n periods, n lambda / 2 in range: 0.41 cm per period at 42 kHz",
    source="zero-crossing and threshold detectors on tone bursts",
    parameters=(
        share_of_readings("share of the readings that slip"),
        Parameter("cycles", "1", "periods that are missed", 1.0, 40.0, None, 6.0, (4.0, 8.0, 12.0, 16.0, 20.0, 24.0)),
    ),
    requires=("true_range_cm",),
    channels=("component",),
    experiment="a histogram of ten thousand readings of one target: a second peak next to the first",
    apply=_apply,
    media=("sound",),
    moves="cycles",
)
