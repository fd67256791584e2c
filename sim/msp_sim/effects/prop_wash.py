"""Effect: the rotors' noise and wash cause short readings."""

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values


def _apply(scene: Scene, values: Values) -> Contribution:
    return Contribution(log_odds_short=values["log_odds"] * scene["throttle"])


PROP_WASH = Effect(
    name="prop_wash",
    sentence="With more throttle the rotors' noise is mistaken for an echo more often, and the sensor reads short.",
    finding="full throttle makes short readings come {log_odds:times}",
    physics="log odds of a short reading grow in proportion to the throttle",
    source="field reports: short readings in flight that do not occur on the bench",
    parameters=(Parameter("log_odds", "1", "log odds at full throttle minus those at zero throttle", -10.0, 10.0),),
    requires=("throttle",),
    channels=("short",),
    experiment="the vehicle tied down over a floor, with the throttle raised in steps",
    apply=_apply,
)
