"""Effect: a constant error that differs from run to run."""

from msp_sim.effects.base import Effect, Parameter, everywhere

RUN_OFFSETS = Effect(
    name="run_offsets",
    sentence="Each session has a small constant error of its own.",
    finding="runs differ from each other by {deviation_cm}",
    physics="an offset drawn once per run from a normal distribution; a reading's variance is sigma^2 + deviation^2",
    source="placement of reference and sensor; temperature of the day",
    parameters=(Parameter("deviation_cm", "cm", "standard deviation of the offsets", 0.0, 50.0, power=2, step=0.03),),
    requires=("true_range_cm", "run"),
    channels=("spread",),
    experiment="the same arrangement, dismantled and rebuilt ten times",
    apply=everywhere("run_offset_cm", "deviation_cm"),
)
