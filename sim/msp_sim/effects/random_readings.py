"""Effect: readings anywhere in the range, without a known cause."""

from msp_sim.effects.base import Effect, Parameter, everywhere

RANDOM_READINGS = Effect(
    name="random_readings",
    sentence="More (or fewer) readings than usual lie anywhere between minimum and maximum.",
    finding="readings at random ranges come {log_odds:times}",
    physics="log odds of a random reading against a hit",
    source="report eq 12",
    parameters=(Parameter("log_odds", "1", "change of the log odds", -10.0, 10.0),),
    channels=("random",),
    experiment="a thousand readings of a wall at 1 m",
    apply=everywhere("log_odds_random", "log_odds"),
    base="reading_model.weights.random",
)
