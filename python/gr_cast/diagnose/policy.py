# SPDX-License-Identifier: GPL-3.0-or-later
"""Every threshold of the engine, by the file that asks for it, each with its unit and its reason."""

import numpy as np

# align
# samples around the taps that a model reaches where a waveform has unknown parts
LOWEST_LAG, HIGHEST_LAG = -10, 26
LAGS_AROUND = (1.0, 0.5, 0.25)  # of these lags, tried in turn where a waveform is known in pieces that are shorter
LONGEST_WHOLE = 200_000  # samples that are fitted at once; of more, parts
PART, FEWEST_PARTS, MOST_PARTS = 100_000, 4, 8  # samples of a part; fewer do not tell the course of a gain
PART_OF_PIECES = 40_000  # known samples of a part of a waveform that is known in pieces, whose fits take more steps
LONGEST_PART = 1 << 20  # samples from the first to the last of a part of which little is known
LEAST_PART = 1000  # known samples that make a part worth a look
LEAST_GATHERED = 4000  # samples of a recording of which some are left out
MOSTLY = 0.7  # share of the samples from which on none is left out
LONGEST_SCAN = 1 << 21  # samples in which a waveform that is shorter than the recording is looked for
BESIDE_A_MOMENT = 1.5  # samples either side of a loss or step that the twin knows by its time
ALIGN_MARGIN = 64  # samples kept around what is known of a short recording
LONGEST_FAST = 1 << 16  # samples, of recording and waveform, up to which a waveform that is sent once is looked for fast turning
FAST = (-0.03, 0.03, -0.06, 0.06, -0.09, 0.09)  # carriers in cycles per sample, each of which finds those beside it
PRODUCT_LAGS = (1, 2, 4, 8, 16, 32)  # samples by which one that a sample is multiplied with is earlier: a symbol, about
NEAR_MOST = 0.5  # of the energy, that a delay near the beginning must hold: then it has no better one elsewhere
LIKE_ITSELF = 0.5  # of a waveform's energy, that it has in common with itself at another delay
LONGEST_EVERYWHERE = 1 << 20  # samples, of recording and waveform, up to which a better one is looked for
FACTORS = (2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31)  # of lengths that are transformed in a seventh to a half of what others take
LEAST_OF_QUICK = 500  # of a recording's samples one may be left out for that, at its end: in the mean it is 24 of 100,000
EDGE = 24  # samples at either end that a filter's memory makes uncertain

# ambiguity
ALIKE_NATS = 3.0  # in ln L: two fits that differ by less are alike
ALIKE_TAPS_NATS = 12.0  # in evidence: what the priors of two rows of taps may differ by
CHOICE = 2  # free numbers that a rival of a mere choice, an effect of no number and no path, may have: one gain
MOST_OPEN = 3  # families that are told as open, the likeliest
NEAR_SHARE = 0.3  # or this share of what the effect brings
NEAR_NATS = 25.0  # predicted evidence within which a rival is worth a fit

# blanks
LEAST_BLANK = 4  # samples: fewer are where a slow signal passes through zero
MUCH_SHORTER = 3  # times, than a run, those that tell how often zeros follow each other
MOST_BLANKS = 12  # runs in a recording: of more a few steps of a slow signal make them
BLANK_NATS = 14.0  # by which a run of zeros is no chance: one of a million samples begins one
MOST_BLANK = 0.1  # of a recording: where more is zeros, it is silent
BLANK_APART = 64  # samples from a joint to zeros that were written there: as exactly as a joint is first guessed

# claims
SIZE_SIGMA = 3.0  # standard deviations by which a size must differ from nothing
CANCELLED = 0.03  # of the power of the weaker of two effects: less is left of both together where one only cancels the other
LITTLE_NATS = 200.0  # below which what has no size is not there, though the numbers behind it are
BROKEN_SIGMA = 2.5  # standard deviations by which held-out samples must contradict the fitted ones

# confidence
SUREST = 0.98  # of an effect for which all figures speak: families that nobody thought of remain
TEMPER_NATS = 4.0  # models are not exact: so many nats count as one, whatever they are compared with
# Of families that have the freedom to look like others: as likely as not one stands for something else that it would fit. What it
# then leaves is seen from UNEXPLAINED_NATS on.
FREEDOM = 0.5
OPEN = 0.5  # at most, where another family fits alike
HURRIED = 0.9  # where the time ended the search
UNPROVEN = (
    0.6  # of what had no time left to be held against unseen samples and rivals: of eight such in sealed worlds two were right
)
CLAIMED = 0.5  # probability of an effect from which on it is told as one: likelier right than not; else it is left
WHOLE = 0.5  # probability of a list from which on it is called the whole truth: likelier right than not

# copies
COPY_LAGS = 12  # samples, either way, by which what is sent is looked for once more in what is left
COPY_BESIDE = 256  # carriers on either side, steps of one cycle over the recording, that tell what chance does at one

# courses
COURSE_SURE_NATS = 20.0  # by which a course must be likelier than none
LEAST = 1e-3  # nepers, rad or samples that it must change over the recording
WRONG_P = 1e-4  # a course that leaves less likely remainders is none
COURSE_TIMES = np.geomspace(0.03, 1.0, 24)  # time constants that are tried, over the recording

# delays
# samples; segments below that must explain so much more: a chirp's delay looks like an offset
DELAY_SHORT, SHORT_FACTOR = 128, 2.0
DELAY_SHORTEST = 8  # samples of the shortest stretch: carriers up to 1/16 of the rate
DELAYS_AT_ONCE = 1 << 18  # delays times carriers that are worked on at once: what a cache holds
PIECES_AT_ONCE = 1 << 17  # sums that are worked on at once: what a cache holds
TABLE = 1 << 20  # correlations, of every stretch at every delay, that are worked on at once
MOST_DELAYS = 1 << 14  # samples at which waveforms of different periods are looked for together
DELAY_LONGER = 8  # times as long are the next ones where the table holds no more
DELAY_SURE_NATS = 15.0  # by which chance does not explain as much at the best delay and carrier
DELAY_ALIKE = 0.8  # of the most nats, from which on carriers are equals
DELAY_CLEAR = 12.0  # standard deviations of the other lags by which a delay stands out
CHIRP_PIECE = 256  # samples of a waveform, its loudest, by which it is known whether another delay is another carrier
CHIRP_REACH = 128  # samples around a delay at which the same with another carrier is looked for
CHIRP_STRIDE, CHIRP_PLACES = 128, 600  # samples from one delay to the next at which it is looked for everywhere; most of these
CHIRP_BEST, CHIRP_STEP, CHIRP_FINE = 32, 16, 4  # of these, around which it is looked for at every so many samples; near the first
CHIRP_FEW, CHIRP_MOST = 1 << 13, 1 << 16  # samples by which that is told, everywhere and of the best
CHIRP_CLEAR = 1.01  # times as much as at the delay that short pieces told is explained by a better one: ends may be alike
DELAY_SEGMENTS = (256, 48)  # samples that are added with their phases: carrier offsets of 1/400 and 1/80 of the rate do no harm
PIECES, DELAY_LEAST_PIECE = 1024, 8  # of a waveform that is sent once, and samples in each at least
WORK = 1 << 28  # lags of all pieces together
DELAY_SILENT = 1e-4  # of the mean energy of a piece: one with less is the tail of a link's response, or nothing
DELAY_GROWTH = 4  # how much longer the pieces of the next length are
# bins of a spectrum and the part of them below a level that stands for all; a line may hold all but so much of the energy
LINE_BINS, LINE_DECILE, LEAST_WITHOUT_LINES = 64, 0.9, 0.01
BEHIND = 64  # samples behind the last path that a link's response is followed

# evenness
EVEN_TOO = 0.01  # p of amplitudes below which a power that beats speaks for another signal
OF_ROUNDING = 0.6  # 2 − E|r|⁴/(E|r|²)² of an error that is even over a square, as rounding's is
# The same of a grid, for nobody knows its dither: with one step of it 1.2 of a signal of many levels, up to 9 of one that stays
# amid two points; with 4 none of 16 recordings of few levels was taken for another signal's.
OF_DITHER = 4.0

# finding
LEAST_TOLD = 20.0  # nats of an effect without a curvature: a search found it

# fit
LARGE = 60  # parameters from which a matrix is inverted by Cholesky's method
DAMPINGS = (0.0, 1e-6, 1e-4, 1e-2, 1.0, 100.0)  # shares of the curvature, tried in turn (Marquardt 1963)
# Steps of gains and rows of taps alone, behind one of all numbers that left their valley, and the share of their curvature that
# holds them: what neighbouring taps of an oversampled waveform do is all but the same.
VALLEY_STEPS, VALLEY_DAMPING = 3, 1e-4
VALLEY_LEAST_NATS = 0.1  # that such a step must bring to be followed by another: far from the optimum some lead away from it
KEPT_PROMISE = 0.75  # of what a step promised, from which on no shorter one is tried
SMALL = 20_000  # samples up to which a fit of many numbers is carried to its end
LEAST_HEARD = 100  # samples off the rails, of which a law of the noise is told
COLOUR_ORDERS = 10  # cepstral coefficients of a receiver's noise colour

# flatness
FLATNESS_TIMES = 48  # cells of time
FLATNESS_LEVELS = 16  # of what is received, as many samples in each
NEXT = 32  # samples: what is alike within fewer is told by frequency
RINGS_ON = 8.0  # over the width of a band: the time within which what is left of it may be like itself
LEAST_PAIRS = 400  # samples so far apart, of which what they have in common is normal
WELL_FILLED, FEWEST_TIMES = 8.0, 4  # samples in a mean cell of a map that is taken whole, and rows that it keeps
LEAST_IN_CELL = 2.0  # samples: of fewer ln of the mean tells next to nothing

# floor
FAINT = 0.01  # of the mean power: what is weaker has no direction
HIDES = 0.1  # power of a grid's own error over the told noise from which the floor cannot be seen
DITHERS = (0, 1, 2)  # times the rounding, that the dither of a grid adds: none, uniform over a step, triangular over two
FLOOR_LEAST_NATS = 8.0  # beyond half a logarithm of the samples, that another level must bring
# dB by which a floor may differ for other reasons: the twin's figure is rounded; the shape of noise with a law of its own is not
# known so well; a course of the oscillator, or any other, leaves some of itself over.
TOLD_DB, SHAPED_DB, WANDERS_DB, COURSE_DB = 0.05, 0.3, 0.2, 1.0
EVEN_P, EVEN_SHARE = 1e-3, 0.1  # of one level everywhere, below which it is none, unless what is uneven is so small a share of it

# heldout
FOLDS = 2
FOLD_RUN, FOLD_OF = 16, 4  # samples at a stretch that a fold leaves out, and of how many such runs one
STRETCH = 64  # samples that may hold what is gained together: impulses that bounce or ring
OFF = 16  # samples by which fitted ones may place a moment beside where it is: what they say may be alike before and behind it

# hopping
HOP_BINS = (32, 64, 128)  # samples of a block: bands of 1/32 to 1/128 of the rate
HOP_LEVELS = np.geomspace(0.1, 10.0, 7)  # of the noise, by which a band may have more
HOP_PACES = (16, 32, 64, 128, 256)  # hops in a recording or a part of one
HOP_SHORTEST = 4  # blocks of a hop: of fewer the cells of time and frequency tell as much
HOP_HEARD = 0.5  # of a block, that must be used samples
HOP_WARMER = 1.05  # power of the likelihood ratio, close to 1, by which its slope is measured

# maps
MAP_LEVELS = 24  # cells of amplitude
MAP_FEWEST = 20  # samples in a cell

# next recording
TELLS_NATS = 20.0  # between what two hypotheses foretell, from which an experiment decides: odds of 10⁸, as models are not exact
NEXT_LEAST_NATS = 1.0  # below which an experiment tells nothing
NEXT_LONGER = 10.0  # times the recording that a longer one is
ERRORS = 3.0  # times what two models that fit alike differ by: what the errors of their numbers may do elsewhere
OFFSET_HZ = 500.0  # of a carrier that is moved a little, the most that the contract asks for
SOFTER = 0.5  # amplitude of a second power and of a second receiver gain

# noise
BLUR_DOUBT = 0.5  # of what a fit's errors add to the floor: draws tell their mean, and a recording has one of them
DRAWS = 8  # of what a fit leaves open: the power of its errors to a tenth, where 60 numbers are open
ROUNDED = 0.25  # of the noise, which a grid's rounding is at least: with a dither of one step its error follows the signal
RINGS, LEAST_APART = 32, 0.5  # samples that an impulse may ring on, and share of them that must be left to ask of other laws
PASSBAND = 0.65  # common share of two bands from which they are one: a filter falls off within the signal's own edges

# offsets
LONGEST_STRETCH = 2048  # samples
OFFSET_PIECE = 256  # samples: stretches that come at regular intervals leave carriers open that only what is within them tells
EARLY, LATE = -8, 24  # lags around the twin's delay in which a link's energy may lie
WORST_CLOCK = 30e-6
CLOCK_STEP = 0.5  # samples over the recording
CARRIER_STEP = 0.5  # cycles over the recording
# standard deviations of a twin's carrier or clock within which it is its own: more is chance once in 10⁴ twins
TOLD_SIGMA = 4.0
TEETH = 3  # on either side of the likeliest carrier, of the comb that regular stretches make
LOBES = 0.5  # of a stretch's spectrum, around its peak, in which the carrier is looked for finely

# mistakes
CARRIER_OFF = 1e-3  # of it; less, and every number that hangs on the carrier is as good as before

# ownership
SIDES_ALIKE_NATS = 3.0  # in ln L, by recording
SILENT_NATS = 20.0  # what a recording can say at most against an effect that it should show and does not

# passing
SURROGATES = 200  # courses of other signs; the tail of their largest contrast is Gumbel's
CELLS = 96  # of time at most, in runs of which a stretch is looked for
LEAST_ORDERS = 12  # cosines: of fewer no stretch can be told
OFTEN = 2  # cells to a cosine
GRID = 8  # points of `grid_of` in a cell
LINE_SHARE = 0.99  # of a course's power, which the orders hold that are asked whether they lie along one line
PASSING_CLEAR = 2.0  # power of a course over the variance of its estimate, from which its cosines are more than noise
DIFFERENCES = (1, 2)  # over time: of a step, or of a ramp, all that moves is then in one place
SURE_P = 1e-5  # of the most uneven course of that spectrum, below which it is no random one

# pieces
REACH = 2048  # samples by which a piece may stand elsewhere
LONGEST_PIECE, PIECES_LEAST_PIECE = 2048, 64  # samples that are looked for together
MOST_PIECES = 1000
STEP_NATS, PIECES_JUMP_NATS = 2.0, 100.0  # that a piece must bring to stand one sample, or many, from the one before it
SPREAD = 8  # samples on either side in which another path may be the strongest for a while
HERE = 1.05  # by which a piece that stands where the whole recording stands is believed more
PIECES_FEWEST = 3  # pieces on either side of a jump

# presence
PRESENCE_PIECE = 4  # samples of the shortest stretch that is added with its phases: carriers to 1/8 of the rate
PRESENCE_GROWTH = 4  # how much longer the next stretch is
LENGTHS = (1 << 13, 1 << 16)  # samples that are looked at: few first, more where these leave a doubt
PRESENCE_SURE_NATS = 60.0  # that few samples must say so that more are not asked
PRESENT_NATS = 14.0  # by which chance would not explain as much at the best of all delays, carriers, lengths: p of 10⁻⁶
HALVES = 3  # stretches of a short recording that are looked at: all of it, and its halves
EXPLAINED_LENGTHS = tuple(4**k for k in range(3, 9))  # samples, of stretches with a gain each: carriers to 1/128 of the rate
LIKELIER = 1.2  # times the nats of the first of several options that another must have
PRESENCE_AROUND = 16  # samples around the delay that was found in which the waveform may be
LOUDEST_SHARE = 0.95  # of the samples, above which impulses may stand over what is sent
NULLS, NULLS_OF_SHORT = 64, 256  # delays near, and as many far, at which it is not; of a short recording
PRESENCE_SHORT = 4096  # samples of one
FARTHEST_NEAR = 8 * PRESENCE_AROUND
PRESENCE_ENVELOPE = 64  # samples over which amplitudes are averaged: more than a symbol's, less than a burst's
ALL_BUT_A_CARRIER = 0.9  # of the energy of a waveform, which its envelope with a carrier holds: without it nothing is left
LEAST_CARRIED = 0.1  # of that energy, from which on a carrier with the envelope is more than a line of a code
PRESENCE_SILENT = 1e-3  # of the mean energy of the waveform in a stretch: less holds none of it
LEAST_OVERLAP = 0.25  # of the most energy of the waveform in the recording at any delay: those with less are not compared
ONE_PHASE = 0.99  # coherence of a waveform with its amplitudes, from which on its phases tell nothing
PRESENCE_ALIKE = 0.7  # coherence of a waveform with itself, from which on another delay makes no other waveform of it
PRESENCE_SHORTEST = 64  # samples in which something is compared at all
LEAST_WHOLE = 0.5  # of the recording, in which something is sent that cannot be compared, if it is to be believed
LEAST_NULLS = 8  # delays that tell a mean and a spread
STEADY = 4.0  # times the number of gains behind a share, from which it is steady over the delays: a line, or what is never silent
HALF_OF_NULLS = 0.5  # a median knows a mean as well as the mean of that share of the values

# residual
WINDOWS = 64  # of time, in which impulses are counted
LEAST_WINDOW = 16  # samples
LEAST_IMPULSES = 5  # in a window at random, from which their counts spread as χ² has it
LONGEST_IMPULSE, TOGETHER = 8, 2  # samples: what lasts longer is a burst, and how far apart are those of one impulse
# Trains of impulses: so many at least, of which one may hold such a share of all; strong samples without a gap in one impulse,
# up to which so many are, for some stand on others.
FEWEST_TRAINS, LARGEST_TRAIN = 8, 0.25
LEAST_COLOUR = 0.02  # of the mean power of pulses, in any band: noise in front of the receiver is always left
SURELY_COLOURED = 5.0  # standard deviations of what bands tell of a colour of pulses: with less they are white
LONGEST_SPARK, MOST_SPARKS = 32, 0.9
CROWDED_P = 1e-3  # of impulses in one window of time, below which they do not come at random
FOREIGN_CELLS, LEAST_CELL = 128, 8  # cells of time, and samples in each at least, in which a stretch is looked for that is not
# what the twin says
FOREIGN, TWIN_FITS = 0.5, 0.35  # residual over the mean wanted power, from which a cell is foreign, up to which the twin fits
HEARD = 0.1  # of the mean wanted power, from which on a course is held by the recording

# run
BUDGET_S = 120.0
PICTURES = 1.1  # of the budget: what a report still draws after the search ends then
# Shares of the time that is left: for the recordings, for the first part of a long one, for the search of a part, and for
# what it found to prove itself.
RECORDINGS, FIRST_PART, SEARCH, PROOF = 0.8, 0.8, 0.7, 0.9
HUNGRY = 3.0  # times the mean share that a recording may take of what is left; most need far less
MOST_FINDINGS = 24  # parts of a recording: what happened between two of 10⁸ samples is halved 12 times until it is found
MOST_SWAPS = 3  # of what was found for a rival that explains more
CUT_NATS = 10.0  # by which rails on a grid, or at one end alone, must make a recording likelier
FINE_GRID = 10.0  # energy of its error over the noise, over the whole recording
JITTER_SURE = 2.5  # standard deviations by which noise across the signal must exceed noise along it
JITTER_ALONE_NATS = 30.0  # by which noise across the signal must explain more than laws that know no direction
JITTER_STRENGTHS = (1e-3, 1e2)  # times the floor, between which its strength is looked for
JITTER_ORDERS = 480  # cosines over which a twin spreads what is too fast for any
JITTER_STRETCHES, JITTER_EVEN = 8, 0.3  # stretches of a recording, and the least that one has of its fair share of such noise
ACROSS = (
    0.5  # of a band's power, by which more is across the signal than along it: all of an oscillator's, none of an interference's
)
FORM_SHARE = 0.01  # of what noise that follows the signal explains, for what it follows otherwise than it is thought to
UNEXPLAINED_P = 1e-5
AT_A_SLIP = 64  # samples about lost ones in which interference may be what a fit makes of them
ALIKE = 0.25  # of the power of two paths' courses, that is the same in both: paths fade each on its own
PIECES_OF_GAIN = 4  # steps, hums, drifts and fadings of one recording, from which on they are pieces of one thing
UNEXPLAINED_NATS = 40.0
UNEXPLAINED_SHARE = 0.01

# search
MANY = 200  # parameters with a prior up to which their dependence is taken into account by a score
SEARCH_MARGIN = 5.0  # nats of evidence that an effect must bring beyond its price
BEAM = 2
ENOUGH_DEVIATIONS = 3.0  # of the power of noise, up to which one cause leaves no more than the noise that the twin tells
STILL_NATS = 30.0  # promised, from which an effect is tried when what promised more did not keep it
REFITS = 3
MOST_EFFECTS = 6  # more are not searched for: a list of so many is hardly ever the whole truth
ANOTHER_PATH = 0.8  # of what is left, at most, with another path where the twin's strongest was looked for
LEAST_STEPS = 3  # of the delay, all the same way, that a clock may make as well as losses
MOST_AT_ONE_PLACE, SAME_PLACE = 2, 0.5  # echoes (as a tap and its change) within so many samples: of more, one path comes or goes
LEAST_STRETCH = 1e-3  # samples by which late paths must differ for a sample clock to show its side
LEAST_COUNTED = 1e-3  # cycles by which a carrier that is known must turn otherwise for a sample clock to show its side
LEAST_TURN = 1e-5  # cycles by which late paths must differ for a carrier offset to show its side
FULLER = 1.5  # times the power at the delay that was found, from which another is tried: of the same path it is what noise adds
LEAP_STEPS = 3  # of a fit, that score an effect which is elsewhere
SEEN = 1e-5  # share of a derivative that must be left when what other parameters can do is taken out
ELSEWHERE = 1e-9  # power by which a start differs from the fit, over that of the fit; less is rounding
LOUDEST = 1.6  # density of noise that a filter coloured, over its median in the signal's band
CLEAR_SHARE, FAR_SHARE = 0.1, 0.7  # of the best score: by which starts of one family, and families, must not stay behind it
LAWS_ROUNDS = 6  # in which laws of the noise that are there together are fitted by turns
BESIDE_NOISE = 0.02  # of what one law of the noise explains, that another beside it must: no law is so exact
INDEPENDENT = 0.2  # sum of a number's squared correlations with all others, up to which it is taken for independent
BAND_OVER_SIGNAL = 4.0  # times what the signal promises, that a band of noise must explain to be fitted before it
CLEAR_NATS = 300.0  # a signal that promises more is fitted before the law of the noise is asked for
SEARCH_SURE_NATS = 100.0  # evidence from which a simple family needs no other proof
PRIOR_STEPS, LEAST_OF_A_STEP = 4, 1.0  # of the scale of a prior, at most, and nats by which one must be likelier for another
PROOF_STEPS = 2  # of a fit to three quarters of the samples, from the fit to all
NOISIEST = 0.3  # of a rail's level, the most noise that softens it: more is a signal not yet found
SETTLED = 0.1  # relative change of that noise that makes no difference
SOFTENED_STEPS = 3  # of a fit, when it changed
LEAST_HELD_OUT = 3.0  # nats on unseen samples that an effect must bring
LEAST_OF_NOISE = 15.0  # nats of evidence: a law of noise fits what a model of the signal leaves over
ROUGH_NATS, ROUGH_SHARE = 10.0, 0.05  # by which, and by which share of it, a score may be off

# slips
LEAST_JUMP = 3  # samples; less is a clock's
HELD = 0.5  # of what the first part's prediction holds: with less, a later part is looked for elsewhere
SLIPS_AROUND = np.arange(-2.0, 2.5, 0.5)  # samples around the strongest lag
SLIPS_SURE_NATS = 100.0  # by which it must be likelier there

# slow
SLOW_ALIKE = 1e-4  # nepers, rad or samples by which fits of parts may differ for reasons of their own
SLOW_FEWEST = 4  # parts that tell one course from another
TIME_STD = 0.15  # of a time constant: the grid's step, and what the parts tell of it
FLOOR_DB, SURE = 0.05, 3.0  # dB, and standard deviations of its own, by which a floor may differ from what a gain makes of it
WANDER = 6e-3  # nepers (0.05 dB) between parts, without a course, that are left unexplained
LEFT_NATS = 40.0  # the same
WORSE_NATS = 3.0  # by which a part may be less likely with what all parts tell of it
OPEN_CYCLES = 0.1  # from one part to the next: with a larger error of what they turn their phases cannot be joined
UNSEEN_CYCLES = 0.02  # that a part turns without an offset being found in it, at least,
UNSEEN = 6.0  # standard deviations of what its phase tells of that

# throughout
STRETCHES, APART = 64, 0.25  # of equal energy, and the share of them, the best ones, that may explain what they do alone
AGAINST_SIGMA = 6.0  # standard deviations by which the others must be against it; three of them are for the choice of the best

# verdict
SAME_DELAY_SAMPLES = 0.7
SURELY_APART = 3.0  # standard deviations
VERDICT_LEAST_NATS = 8.0  # that an effect must bring over all recordings
REFUSED_NATS = 40.0  # of an effect that unseen samples speak against, from which it is left unexplained

# view
DRIFT_BLOCKS, DRIFT_SMEARS = 64, 0.75  # stretches of a recording; share of what they hold that a carrier without drift does
DRIFT_CLEAR = 1.2  # times as much as without a drift is held by a drift that is there
MOST_DRIFT, DRIFT_STEP = 512, 4  # cycles of drift over the recording that are looked for, in such steps first
FASTEST, FASTER = 5, 1.5  # times the fastest course of all taps, of a fast one; times the power faster still, that tells it
QUIET = 0.1  # of the loudest surroundings of any line, below which the clearest are looked at beside the strongest
SKIRT, VIEW_AROUND = 6, 64  # half cycles over the recording: what a line reaches itself, and its surroundings
LEAST_SEGMENT = 40  # samples in which a waveform is looked for alone
VIEW_SEGMENTS = 48  # of time in which a jump is looked for, beside shorter ones at the ends
LONGEST_JUMP = 900  # samples of a waveform that is sent once; of one that repeats every jump is one within its period
LEAST_SENT = 1e-3  # of the mean power of a link: less is silence
MOST_PERIODS = 3  # of a repeated waveform, lost beside what its delay tells
PERIOD_CYCLES = 0.02  # of an oscillator's phase, by which each of them must tell it better: what a fit leaves open of it
MOST_JUMPS = 6  # in one recording: with more the path of its delay is a slope, or noise
VIEW_JUMP_NATS = 10.0  # by which two parts must be likelier than one
RAMP_CELLS, LEAST_RAMP_CELLS = 48, 8  # of time, between which a phase may begin or end to turn; of fewer none is told
LEAST_RAMP = 1e-3  # of the energy of a course that a ramp must have besides what is fitted anyway
NEARLY_ALL_OF_PHASE = 0.9  # of what a recording says of a phase, that a law of it must explain to be one
POINTS, SLOW_POINTS = 8192, 1024  # of a gain's course that show a hum's harmonics
HARMONICS = (1, 2, 3, 5, 8)
HUM_POINTS = 64  # to a cycle of a fast hum: eight to one of its highest harmonic
STILL = 2.0  # places of an echo that stands still for each delay: it may as well turn
ECHO_SEGMENTS = 32  # stretches of time in which an echo is looked for at least: Dopplers up to 16 cycles over the recording
ECHO_CELLS = 1 << 19  # stretches times delays, up to which faster ones are looked for
UNSIGNED = 2.0  # amplitudes of a signal's own line at half the sample rate, by which a delay may change it: there it has no sign
LINE_NATS = 5.0  # by which a line stands out of the largest of as many peaks of noise
SLOW_HUMS = tuple(np.arange(1.0, 6.0, 0.05))  # cycles over the recording, seen once at least, too few for lines apart
