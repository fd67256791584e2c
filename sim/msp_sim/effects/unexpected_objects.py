"""Effect: objects in the beam that are nearer than the surface."""

from msp_sim.effects.base import Effect, Parameter, everywhere

UNEXPECTED_OBJECTS = Effect(
    name="unexpected_objects",
    sentence="More (or fewer) objects than usual are in the beam above the ground.",
    finding="short readings come {log_odds:times}",
    physics="log odds of a short reading against a hit",
    source="report eq 10",
    parameters=(Parameter("log_odds", "1", "change of the log odds", -10.0, 10.0),),
    channels=("short",),
    experiment="an empty hall and a furnished one",
    apply=everywhere("log_odds_short", "log_odds"),
    base="reading_model.weights.short",
)
