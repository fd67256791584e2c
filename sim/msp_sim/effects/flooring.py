"""Effect: ranges are truncated to whole centimetres instead of rounded."""

from msp_sim.effects.base import Contribution, Effect, Scene, Values, share_of_readings


def _apply(scene: Scene, values: Values) -> Contribution:
    return Contribution(bias_cm=-0.5 * values["share"])


FLOORING = Effect(
    name="flooring",
    sentence="The sensor truncates to whole centimetres instead of rounding, so it reads half a centimetre too near.",
    finding="{share:of} readings are truncated instead of rounded",
    physics="floor(x) = round(x - 1/2): an offset of half a step, independent of the noise",
    source="integer arithmetic",
    parameters=(share_of_readings("1 if every reading is truncated"),),
    requires=("true_range_cm",),
    channels=("bias",),
    experiment="none: it equals an offset of -0.5 cm, and both are calibration",
    apply=_apply,
    equivalent_causes=("an offset of -0.5 cm",),
)
