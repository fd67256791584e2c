"""Every threshold by which the gap workflow decides something, in the order of its steps.

Each has three sentences: the decision it makes, where its value comes from, and what changes when it is moved. 'The
blind tables' are those of `evaluation/blind`, in which a generator that shares no code with the product hides effects.
"""

from msp_range.reading_model.rows import Base

# What several steps ask.

FEW_READINGS = 5.0
"""Fewer readings of a kind decide nothing. A component or a fault of the code explains at least so many, since any
three that the model thinks impossible have a name of the catalogue that fits; a value that comes less often is no code,
as five equal random readings of 700 values in a table of 1,000 have a probability below 1e-6; a curve needs so many
that speak of it for each degree of freedom, as below about five a chi-squared is no chi-squared; and where fewer of a
part depend on a number, the part is fitted, since a quadratic cannot say what its fit would: one 255 among the missed
readings moved their share by more than 1. Higher: rare faults in short tables have no name, and splits are slower;
lower: names, codes and curves of single readings."""
SURE_Z = 3.0
"""So many standard errors are no random variation. By them two effects are distinguishable (never wrong in a trial with
known effects), readings come in clumps (of ten lengths of blocks the largest is above 3 in one case of 70), and growth
with range is more than a bench leaves open (of 100 tables without an effect two had grown by two). Lower: pairs are
resolved wrongly, right names lose evidence to clumps, and growth of nothing is named; higher: more alternatives, and an
object that came a few times is named as one that is always there."""
FAR_SIGMAS = 4.0
"""Readings that are off by more sigma are far: at four the likelihood of a hit is that of an outlier of one in 3,000.
Hits so far off are asked as a curve of medians, and readings so much nearer than the hit for places where they gather.
Lower: curves that the scores see as well are refitted twice, and tails of the hits gather before a surface that stays;
higher: what is far is found as scatter or short readings."""
HIT_WINDOW = (10.0, 0.2)
"""Readings within so many cm plus this share of the range are of the surface: from these a fit of the base starts, and
so far off the median of a cell may be. What is farther is another echo. Wider: outliers count as hits, and cells full
of outliers report a bias."""
KEEP_SHARE = 0.6
"""A candidate is refitted if the screen promises this share of the gain that it needs, and a term stays while it gains
as much of it. A screen is a quadratic, and what was certain alone may share its evidence with later terms. Higher: weak
effects are lost, and terms come and go; lower: slower, and needless terms stay."""
RUN_BLOCKS = 8
"""Each run is cut into so many blocks to see whether sums over neighbours scatter: the longest clumps are of that
length, and blocks distinguish offsets of runs from a wander. The variance of eight sums is known to a factor of 1.5.
More: a wander that is over in an eighth of a run is seen as one, and an object that stood there for an eighth of the
time counts as many; fewer: a wander counts as offsets."""

# Runs and their splits into parts.

MIN_RUNS = 4
"""With fewer runs, blocks of consecutive readings are split in their place. Three runs leave one of them on a side, and
two on the other, so nothing constant within a run could be validated. Higher: more recordings lose what differs from
run to run; lower: a single run validates."""
SPLITS = 10
"""So many different splits are drawn, where the runs allow them (six runs allow five, fewer one). Nine of ten have to
agree, which is the coarsest share near 0.9. More: slower, and the same names."""
PARTS = 5
"""Runs are split into so many parts, each scored by a fit of the others; fewer than five runs into single runs. A
number that is fitted costs 1 + 1 / (2 (parts - 1)) nats of what it gains: 1.5 with halves, 1.1 with five parts. And a
fit of four fifths is so near that of all runs that sums of scores give it; one of half of six runs is not. Fewer: weak
effects and those of few runs are lost; more: what one run alone shows is validated by fits that are nearly the same."""
SPLIT_BLOCKS = 60
"""So many blocks of consecutive readings are used as runs where these are too few. A part has twelve: the standard
deviation of so many sums is known to a fifth. Fewer: parts are less alike; more: neighbouring readings that depend on
each other fall into different parts."""
WARN_RUNS = 8
"""With fewer runs, a note says what that costs, and blocks of readings are the units of the measures' errors. A
standard error over seven differences is itself known to 27 % only. Fewer: errors of few runs decide."""
DEPENDENT_P = 1e-3
"""Runs whose means differ with a smaller p-value make the run the unit of evidence. One table in 1,000 with independent
readings may lose power by it. Higher: more such tables lose power; lower: offsets between runs make false names."""
DEPENDENT_LAG_Z = 3.5
"""Neighbouring residuals that correlate by more standard errors make the correlation of the noise a number of the base;
where they still do next to it, the run is the unit of evidence. As `DEPENDENT_P`, one-sided: p = 2e-4. Lower: tables of
independent readings lose power; higher: slow noise makes false names."""
RESTART_CORRELATION = 0.9
"""With a larger correlation of neighbours an effect on the bias is also fitted from half of it. There noise explains
all but a fifth of an error's variance by the error before, and stands in for latency on a robot's log (0.98 in place of
0.70 with a delay of 360 ms). Lower: more fits that end the same."""
EXACT_REPEATS = 0.75
"""Where this share of the repeated whole centimetres repeats exactly in a file of finer steps, readings are held, and
those that differ by less than the sensor's centimetre count as held too. On a robot's log with 0.81 exact, taking them
for new readings gave a delay of 0.27 s instead of 0.35, the rest going into correlated noise; rounding alone makes a
share of 0.2 in millimetres, and counted as held it makes the name `stale`."""

WANDER_BLOCKS = 4
"""Each run is cut into so many blocks to see a slow wander. A wander slower than a run is an offset of it, one faster
than a quarter shows as correlation of neighbours. More: shorter wanders are seen, each with less certainty."""
WANDER_P = 0.01
"""Block sums that scatter about their run's mean with a smaller p-value are a wander, and runs that differ by more than
a wander inside them leads to with a smaller one have offsets. Next to dependent runs a wander is likely, so a higher
value than `DEPENDENT_P`; a wander that lasts for a run is nearly an offset: at 0.0001 offsets of 0.3 sigma are found in
0.7 of tables of 20 runs and 0.1 of 8 runs, at 0.01 in all and 0.7. Higher: independent readings lose power, and wanders
are named run offsets; lower: a wander makes names. Next to one run that is off, others that scatter more than the model
says with a smaller one count alone."""

# Intake: point masses that the model does not declare.

CODE_SHARE = 0.001
"""A value that is a smaller share of the readings is no code. One in 1,000 is the smallest share of missed readings
that a model file usually has. Lower: random readings that repeat are set aside as codes."""
CODE_TIMES_NEIGHBOURS = 8.0
"""A code is so many times as frequent as the mean of the values within 3 cm. Counts of random readings scatter by their
root, so 8 times is beyond any scatter. Lower: an object in the beam is set aside as a code."""
CODE_TIMES_NEXT = 30.0
"""A code is so many times as frequent as the value next to it. What stands in the beam reads over some centimetres, a
code at exactly one. Lower: a still object is set aside as a code."""
CODE_SPAN = 0.2
"""A code comes at true ranges that span this share of all ranges. An offset or a short range gives the same value from
one place. Lower: a long stop at one range is set aside."""
CODE_FAR = (6.0, 0.03, 2.0)
"""A reading can be a code if it is so many sigma, plus this share of the range, plus so many cm from a hit. The share
is what air and offsets can do. Smaller: hits are set aside."""
COARSE_SHARE = 0.99
"""Readings are on a coarser grid if this share of them is a multiple of its step. The rest are codes and outliers that
pass a filter. Lower: a few readings look like a grid."""

PAUSE_S = 30.0
"""Where there are few runs, times that are farther apart are said to be pauses, which may be between flights [s].
Lower: a pause in which a log was flushed is said to be one."""
MIN_COPIED = 20
"""Two runs of at least so many equal readings and true ranges are copies of one. Independent noise of one centimetre
repeats 20 readings in fewer than one case of 1e9. Fewer: short runs at one place are dropped as copies."""
MIN_KNOWN_SHARE = 0.3
"""A column with blank cells is asked where it is known, if that is this share of the readings. Fewer are another table.
Higher: more columns with blanks are not asked; lower: few readings decide on the others."""

# Cells of context, and the free fit of five numbers in each.

MIN_CELL_READINGS = 40
"""A cell with fewer readings is put together with others. With 2 % outliers of a kind 40 readings have less than one of
them. Fewer: cells say nothing of outliers; more: small cells hide."""
MAX_WORDS = 30
"""So many of the most frequent words of a column get a cell each. More do not fit into a picture. It changes the list
of slices and nothing else."""
PAIR_BINS_READINGS = 2000
"""With fewer readings each of two crossed numbers has two bins, else three. Nine cells of 2,000 readings have 220 each.
Lower: cells of pairs are left out as too small."""
CELL_PRIOR_DEVIATION = (50.0, 2.0, 2.5, 2.5, 2.5)
"""Standard deviations of the prior of a cell's bias [sigma], log spread and log odds. Wide compared with any effect of
the catalogue (odds by 12, spread by 7), so that it only holds what a cell has no readings of. Narrower: large gaps are
reported smaller."""
CELL_MIN_HITS = 10
"""A cell's fit starts at its median if it has so many readings below the maximum. A median of fewer is worse than the
model. Fewer: fits start at outliers."""
CELL_MAX_LOG_ODDS_VARIANCE = 0.3
"""A cell's odds count in the measures if their variance is smaller. About three readings of the kind are that certain.
Larger: odds of nothing are reported as a gap."""
CELL_KNOWN_SHARE = 0.7
"""A measure of odds is reported if this share of the cells counts. The others would be invisible in it. Lower: it
speaks for few cells."""
ITERATED_PARTITIONS = 3
"""The free fit is iterated to the end in so many partitions, those that differ most in one step. Each takes as long as
a refit. More: slower, and the measures hardly change."""

# The noise floor: what a gap of nothing shows.

REPLICATES = 20
"""So many tables are simulated for the noise floor. The 95 % point of 20 is known to a factor of about 1.3 (see
`NOISE_FLOOR_FACTOR`). More: slower and surer."""
NOISE_FLOOR_SHARE = 0.95
"""The noise floor is what this share of the simulated tables stay below. The usual level. Higher: wider bounds."""
NOISE_FLOOR_MAX_WIDENING = 10.0
"""Sums of few dependent runs widen the noise floor at most so many times. Four runs may show almost anything. Higher:
any gap of few runs counts as closed."""
MIN_CELL_UNITS = 4
"""A cell that fewer runs or blocks share has the errors of the other cells. A variance of three numbers is known to a
factor of four. Fewer: such cells look certain."""
MAX_UNITS = 256
"""More runs or blocks are pooled with their neighbours. A bootstrap over 256 units is as good as over more. More:
memory and time."""
UNIT_BLOCKS = 64
"""So many blocks stand in for runs as units of errors. As `SPLIT_BLOCKS`, a power of two. Fewer: less certain errors;
more: dependent neighbours count as independent."""
MIN_BLOCK_READINGS = 5
"""A block has at least so many readings. Noise that is correlated over five pings stays in one. Fewer: as for more
blocks."""
MAX_MEASURED = 12_000
"""The measures are taken on a sample of at most so many held-out readings. Their errors are then a tenth of the
bounds. More: slower."""
EXPANSION_FACTOR = 2.0
"""Where a slice's free fit gains so many times more or less than one step from the model promises, its p-value is that
of the likelihood. The score is then no longer a slope that means anything: readings so improbable that the model's
likelihood is flat. Higher: a dead zone can have p 1; lower: the bootstrap by runs is set aside more often."""
SLICE_DRAWS = 999
"""So many bootstrap draws correct the p-values of the slices. The smallest p-value is then 0.001. More: slower."""

# Candidates and their screen.

MAX_RUN_CANDIDATES = 24
"""An effect of one run is asked of each run up to so many. Every run is one more possible false name: 12 on
top of 70 candidates raise the limit for all of them from 3.38 to 3.43 standard errors, 60 to 3.55. More: weak right
names are lost; fewer: of campaigns with more runs nobody is told that one of them is off."""
SHAPE_COST_NATS = 0.7
"""So much is taken off a candidate's gain for each shape parameter that was searched. A chi-squared with two degrees
gains half a nat more than with one, and the best of several shapes a little more. Lower: shapes fit noise."""
PLACE_COST_NATS = 2.0
"""The same for the place at which a component gathers readings. About the logarithm of the number of places that
differ. Lower: components are named for a few readings at one place."""
GATHERED_COST_NATS = 4.0
"""The same for a place that was chosen where readings gather: the logarithm of some fifty places of 8 cm. Lower:
clutter is named for the largest of many random clumps; higher: clutter needs more readings."""
GATHERED_LEAST_NATS = 8.0
"""A place has to stand out of its neighbourhood by so much: that cost, and what a name needs. Lower: a hump of short
readings that is wider than the base model has it counts as clutter (robot_hcsr04 of docs/real_data.md: 4.1)."""
GATHERED_CM = 4.0
"""They gather within so much of a place [cm], twice the scatter that clutter starts with. Wider: two legs are one."""
GATHERED_PLACES = 4
"""At most so many places are searched: the legs of a quadrotor. More: slower."""
COLLINEAR = 1e-3
"""A candidate of which the base and the accepted terms leave a smaller share of its information is not tested. Its
number would rest on rounding. Lower: names that are the base's own."""
PROFILED_Z = 1.0
"""A candidate whose score is so many standard errors from nothing is asked what it gains. Nothing is refitted for less
than 1.8 (`EXCHANGE_KEEPS` of what a name needs), and the largest of 60 candidates is below 1 in one table of 1e10.
Lower: slower, and the same names."""
SCREEN_DRAWS = 2_000
"""So many draws give the critical value of the largest z. Its 95 % point is then known to 0.03. More: slower."""
REPLICATE_ROWS = 6_000
"""Information per reading comes from so many simulated readings. Outliers of 1 % are then known to 13 %. More:
slower."""

# Refits.

READINGS = 20_000
"""Effects are named on a sample of at most so many readings. At 20,000 a bias of 0.03 sigma is certain. More:
slower, and smaller effects."""
STRETCH = 10
"""Readings of a sample come in stretches of so many neighbours (`msp_lab.gap.runs.sample`): the correlation with the
reading before is that of 9 in 10. More: fewer places, so that a context that stays for less than a stretch of each part
may be missed; fewer: less to see of how readings depend on each other."""
BASE_BOUND = Base(20.0, 3.0, 12.0, 12.0, 12.0, 4.0, 1.0, 1.0)
"""The base may move so far: cm, logarithms of spread and odds, of the short readings' rate, the saturated share, the
correlation. What is farther is another sensor. Wider: fits that end at nonsense."""
BASE_DEVIATION = Base(1.0, 0.15, 1.0, 1.0, 1.0, 0.5, 0.2, 1.0)
"""Standard deviations of the prior that holds the base near the model file (`refit`). About how far a characterised
base is off; a table of 1,000 readings is 30 times as certain. Narrower: effects take what is calibration; wider:
what the readings cannot tell drifts."""
CURVE_PRECISION = 0.05
"""Precision of the prior about 0 for the values of curves and for log odds. It holds a knot that no reading is near,
and odds where all readings are of one kind: else misses beyond an angle are certain, and a single echo there, in runs
that were not fitted, contradicts it by 20 nats. One reading has as much. Larger: curves are flattened."""
WIDE_LOG_SPREAD = 0.4
"""Readings that are wider than the model by more, in the logarithm, start their base fit at their own spread. From the
model's spread they look like outliers and have no slope. Lower: two fits where one would do."""
MIN_HIT_SHARE = 0.3
"""A base fit starts at the readings' median if this share of them is in that window. Fewer are not most of the hits.
Lower: it starts at outliers."""

# Forward selection.

REFITS_PER_STEP = 12
"""At most so many of the best candidates are refitted in a step. 4 and 36 gave the same names on the first seven blind
tables of seed 7. More: slower."""
REFIT_WITHIN_NATS = 8.0
"""Candidates whose screened gain is within so many nats of the best are refitted, wider than `ALTERNATIVE_NATS`. A
screen is a quadratic, and off by some nats for gains of ten to twenty; 2 and 18 gave the same names on the first seven
blind tables of seed 7. Lower: wrong names, and alternatives are missed; higher: slower."""
REFIT_WITHIN_SHARE = 0.5
"""Large gains within this share of the best are refitted. A quadratic promises too little of what is large.
Higher: slower."""
CLUMP_MAX_SHARE = 0.6
"""Clumps are looked for in what a smaller share of the readings has. A table that is rounded to inches throughout has a
share of 1, at which slopes rest on readings that never came. Lower: an object in the beam of half of the readings is
taken for a part of the sensor; higher: whole tables of something count for too little."""
MOVED_SHARES = (0.1, 0.3, 0.7)
"""Hits of which a part is moved are fitted from the best of these shares. A fit finds the right one from any of the
same half. More: slower."""
MOVED_SIGMAS = (1.0, 2.0)
"""And from moves by so many sigma, with a spread that leaves the variance of all hits as it was. Of moves by more than
three sigma the screen sees the most. More: slower."""
MOVED_LEAST_SIGMAS = 1.0
"""A part of the hits that is moved by less than so many sigma is no name: two such peaks are one, and any noise that is
not quite normal is fitted by them. Higher: small slips are lost; lower: the form of the noise is a slip."""
SAME_FORM = 0.98
"""An effect on the bias is not added next to another one if their shifts of the readings correlate by more. A bend in
the middle of the range correlates with a scale by 0.94, a late threshold with a linear rise by 0.99 to 2 m. Higher:
pairs that cancel, of which neither is there; lower: a scale has no bend next to it."""
SHAPE_STARTS = 25
"""A refit starts at the best of so many values of a shape's parameter. Ripples and places have many local maxima.
Fewer: shapes end in the wrong one."""

# Curves for what no name explains.

KNOTS = (2, 3, 6, 12)
"""A curve is asked at the most of these knots, and refitted with each that its smoothness allows; over two variables,
with the two smallest for each. A word is a knot; more words, or pairs of knots, than the most are not asked. More:
slower, and faster ups and downs are seen."""
SMOOTHNESS = (1, 2, 4)
"""A curve is asked with so many directions of a walk counting by more than a half, and with all alike. The chi-squared
of one direction is that of a line, of all that of a value for each knot. More: each is one more test."""
BETWEEN_RUNS_SHARE = 0.9
"""A column with more of its variance between runs is one of runs, such as a surface or a battery. What is left inside
runs is a tenth. Higher: runs with such causes are said to differ at random; lower: what varies inside runs is asked by
runs."""
PAIR_COST_NATS = 8.0
"""A curve over two variables has to gain so much more than one over one of them, and `FORM_SHARE`. What depends on one
shows over that and any other, too, and the best of ten others gains some nats by chance. Lower: pairs hide single
causes; higher: what depends on both at once is a curve over each."""
CURVE_P = 0.004
"""A curve is added if random variation shows as much, anywhere, with a smaller probability. Names have alpha 0.01 in
all and curves a share of it. Higher: false curves."""
RIPPLE_CYCLES = 5.0
"""Ripples are asked up to a period of which the readings hold so many. Curves of 12 knots see what is slower. Lower:
bends and a slow wander are named ripples."""
RIPPLE_NEIGHBOURS = 40
"""The power of a frequency is compared with so many independent ones on either side. Their mean is then known to 16 %,
and 22 nats count as 18. More: noise that changes over frequency counts as alike; fewer: less power."""
CURVES_REFITTED = 6
"""So many of the likeliest curves are refitted until one keeps its promise. Scores of rare outliers promise too much.
More: slower."""
MAX_CURVES = 3
"""At most so many curves are added in one go. What needs more has another cause. More: slower."""
CURVE_OF_RUNS_SHARE = 0.5
"""A curve that makes more of its gain by moving whole runs is one of runs, and has to be known from as many of them.
One that is known from readings inside runs has less there. Higher: sessions become curves; lower: curves over what
varies in both are lost where runs are few."""
CURVE_RUNS_PER_DEGREE = 3
"""A curve that explains differences between runs needs runs at so many places for each degree of freedom. Any curve
goes through fewer: 29 runs at eight ranges took one of eight knots. Lower: sessions become curves."""
ONE_PLACE = 0.02
"""Runs whose means of a column differ by less than this share of their span are at one place of a curve. A tape measure
is read to that. Larger: fewer places, and coarser curves; smaller: runs at one place count as several."""
FORM_SHARE = 0.85
"""A name that gains this share of what a curve gains takes its place, and a curve over one variable that of one over
two. The physics of an entry is rarely exact; 0.6 and 0.95 gave the same names on the first six blind tables of seed 7.
Higher: right names become unknown; lower: wrong names take the place of curves."""


# Exchange, alternatives, elimination.

EXCHANGE_LOSES = (8.0, 0.1)
"""A candidate takes a term's place if the readings alone lose so many nats by it at most, or this share of the term's
gain. Where each run is at one range and has an offset of its own, a rounding to 2.54 cm took the place of a scale that
gains seven times as much. Higher: that; lower: among runs with offsets the first name stays."""
EXCHANGE_KEEPS = 0.3
"""They are refitted if the screen promises this share of the gain that a term needs. As `KEEP_SHARE`, for weaker
ones. Higher: alternatives of weak effects are missed."""
SIMPLER_NATS = 2.0
"""An effect of the same form as another (`SAME_FORM`) has to gain so much more for each additional number. A number
that is not there gains more in one case of 20. Higher: a late threshold and a bend are scales; lower: a scale is a late
threshold with a linear rise."""
BASE_PREFERENCE_NATS = 3.0
"""An effect has to gain so much more than a number of the base in its place; one that does not is asked next to that
number. What calibration explains is not missing. Lower: offsets of the model and tails of its noise are named
effects."""
RELATED = 0.2
"""Two effects whose scores correlate by less explain different things: none takes the other's place or is its
alternative. In place of tails of the noise (0.01) air temperature was named for runs that wander. Higher: a better name
for the same is not found."""
ALTERNATIVE_NATS = 5.0
"""Names within so many nats of the best are listed as its alternatives. At 3, 2 of 86 pairs of the blind tables were
resolved wrongly, at 5 none. Higher: more names in every answer."""
IMITATES = 0.9999
"""An effect with more numbers, over no column that the named one lacks, is no alternative if their scores correlate by
more: its numbers make it the same statement, as a bend does that begins at the nearest reading and so is a scale. A
bend after 3 % of the range has 0.99995, after 5 % 0.9998. Higher: such a bend is an alternative; lower: bends near the
end are scales."""
TAILS_START = 0.05
"""The share of wide hits at which their fit starts. The middle of its usual range. It changes the speed of a refit."""

# Offsets between runs.

RUN_SCATTER_FREEDOM = 4.0
"""That runs scatter as the model says counts as so many runs when one of them is said to be off. With ten runs it is
then a third of what is known. Higher: slow noise makes a run of nothing odd; lower: of few runs none is found."""
RUN_OFFSETS_P = 1e-4
"""Runs differ by more than the model says if random variation shows it with a smaller probability. Stricter than a
name, since it has no variable that could be checked. Higher: drifts are named run offsets."""
MAX_BETWEEN_SHARE = 0.95
"""At most this share of the variance lies between runs. The rest keeps a spread within them. It only matters for tables
of repeats."""

# Validation in splits of the runs.

SPLITS_AGREE = 0.9
"""A term is kept if it holds in this share of the splits. Nearly all splits agree on a true effect of six standard
errors. Higher: weak right names are lost; lower: names that depend on which runs were fitted."""
VALIDATED_Z = 0.5
"""In a split a term holds if its gain is so many standard errors above nothing: the mean over all runs, each scored by
the fit of the part that it is not in. Chosen by judgement. Higher: weak right names are lost."""
VALIDATED_NATS = 2.0
"""And if it gains so much in all. The smallest gain of a term of 2 standard errors. Higher: as above."""
LEARNT_SHARE = 0.1
"""A run counts if a fit without its part still has this share of what all runs know of the term's strength there; five
parts that are alike leave 0.8. Higher: causes that vary in few runs cannot be validated; lower: strengths that one run
decides."""
EXPANSION_NATS = 3.0
"""A part's fit follows from the sums of scores if it gains no more than so many nats for each number over that of all.
Half a nat is usual where readings are independent. Higher: parts that differ are taken for more alike; lower:
slower."""
SPLITS_FITTED = 3
"""So many splits are used that have parts to be fitted, where a quadratic cannot say what their fit would, next to all
others. Six terms in ten splits of five parts are 700 fits. More: slower, and surer where readings are few for a
number."""
PART_ROUNDS = 3
"""Such a part is fitted by so many steps of Newton at most, from the fit of all runs. What is left after three steps is
small against what a name gains. More: slower, on a robot's log of 4,819 readings by a minute."""
ROW_NATS = 5.0
"""A reading at which the truth moves counts for at most so many nats for or against repeated readings. A hit that
becomes a random reading loses about 8. Higher: where the truth jumps by an error of its own, one reading decides;
lower: repeats need more of them."""
FINAL_ROWS = 60_000
"""The values that are reported are fitted to a sample of at most so many readings. Three times those of the
search. More: slower, and narrower intervals."""
CALIBRATION_Z = 4.0
"""A number of the base is reported as calibration if it moved by so many standard errors, and in the same direction on
the training runs alone. Eight numbers are asked. Lower: calibration of nothing."""
BENCH_ERROR = {"reading_model.sigma_growth_cm_per_m": 0.03, "reading_model.missed_growth_per_m": 0.1}
"""Standard errors of what a bench says of growth with range: of the spread in shares of sigma per metre, of missed
echoes in log odds per metre. On 18 benches of 48 ranges and 2,400 readings (`evaluation/second_hand`) the first
scattered by 0.02 about a straight line through the true growths, which have another form; 50 missed readings say the
second to 0.1. Higher: growth is calibration; lower: growth that the bench had, too, is named."""
POWER_Z = 0.84
"""The smallest effect that would have been found is taken at this normal quantile. Four of five effects of that size
are found. Higher: larger sizes are reported."""

# The verdict: how large a gap counts as closed.

CLOSED_BIAS_SIGMAS = 0.1
"""A bias up to so many sigma counts as closed. A tenth adds 0.5 % to the root mean square error. Higher: larger gaps
count as closed."""
CLOSED_SPREAD_RATIO = 1.05
"""A spread within this factor counts as closed. Intervals are then 5 % wrong. Higher: as above."""
CLOSED_NATS = 0.005
"""A gap up to so many nats per reading counts as closed. As the bias: 0.1 sigma costs 0.005 nats. Higher: as above."""
NOISE_FLOOR_FACTOR = 1.3
"""Where the noise floor is higher, a gap up to so many times it counts as closed. A 95 % point of `REPLICATES` tables
is known to that, and three measures are asked. Higher: gaps in small tables count as closed."""
CLOSED_MAX_BIAS_SIGMAS, CLOSED_MAX_SPREAD_RATIO, CLOSED_MAX_NATS = 0.5, 1.25, 0.05
"""A larger gap is never closed, whatever the noise floor. Few dependent runs may show almost anything. Higher: few runs
explain everything."""
CURVE_NUMBERS = 4
"""A curve counts as so many fitted numbers in the cost of fitting, one over the readings for each. Curves have 2
to 12 knots; at 12 the limit for 3,000 readings is 0.003 nats higher. More: larger gaps count as closed."""
PARTLY = 0.9
"""'Partly explained' needs a gap after that is smaller than this share of the gap before. A gain of less than a tenth
explains nothing. Lower: more gaps are 'unexplained'."""
SLICE_P = 0.05
"""A slice differs with a smaller corrected p-value, as long as nothing found says where. The usual level. Higher: more
slices."""
