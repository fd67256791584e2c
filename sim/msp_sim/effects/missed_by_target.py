"""Effect: a material that absorbs the ping."""

from msp_sim.effects.base import Effect, Parameter, everywhere

MISSED_BY_TARGET = Effect(
    name="missed_by_target",
    sentence="One kind of ground absorbs the ping, so over it echoes are missed more often.",
    finding="over {of} missed echoes come {log_odds:times}",
    physics="log odds of a missed echo over one target; reflected energy: msp_sim.acoustics.materials",
    source="report eq 4 and 4.3.4: plywood, asphalt and concrete reflect equally; snow and grass reflect far less",
    parameters=(Parameter("log_odds", "1", "change of the log odds over this target", -10.0, 10.0),),
    channels=("missed",),
    experiment="this target and a plate side by side at the same range",
    apply=everywhere("log_odds_missed", "log_odds"),
    media=("sound", "light"),
    per="target",
)
