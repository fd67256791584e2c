"""Effect: more echoes are missed, without a known cause."""

from msp_sim.effects.base import Effect, Parameter, everywhere

MISSED = Effect(
    name="missed",
    sentence="More (or fewer) pings than usual come back without an echo.",
    finding="missed echoes come {log_odds:times}",
    physics="log odds of a reading of the maximum against a hit",
    source="report 4.3.2: 765 now and then",
    parameters=(Parameter("log_odds", "1", "change of the log odds", -10.0, 10.0),),
    channels=("missed",),
    experiment="a thousand readings of a wall at 1 m",
    apply=everywhere("log_odds_missed", "log_odds"),
    base="reading_model.weights.missed",
)
