"""Effect: objects in the beam that are nearer than the surface."""

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values


def _apply(scene: Scene, values: Values) -> Contribution:
    return Contribution(log_odds_short=values["log_odds"])


UNEXPECTED_OBJECTS = Effect(
    name="unexpected_objects",
    sentence="More (or fewer) objects than usual are in the beam above the ground.",
    finding="short readings come {log_odds:times}",
    physics="log odds of a short reading against a hit",
    source="report eq 10",
    parameters=(Parameter("log_odds", "1", "change of the log odds", -10.0, 10.0),),
    channels=("short",),
    experiment="an empty hall and a furnished one",
    apply=_apply,
    base="reading_model.weights.short",
)
