# SPDX-License-Identifier: GPL-3.0-or-later
"""Every threshold of the diagnosis of places, with its unit and its reason."""

BUDGET_S = 320.0  # of processor time, of which 0.85 go to the search; one that runs out of it takes 243 s alone. With 240 s ten
# of 77 cases failed on the bench, nine of these for want of time
MOST_EFFECTS = 4  # more were never right: what is left then is unexplained
LEAST_EVIDENCE_NATS = 8.0  # an effect is worth it beyond the price of its numbers and of all that was tried: 1 in 3000 by chance
CLEAN_DEVIATIONS = 4.0  # standard deviations of the energy of noise: above, something is left
RIVAL_NATS = 6.0  # another explanation that is not worse by more is open: odds 1 in 400
MOST_ALIKE = 3  # other families that are told to explain as well as one
FITTED_AFTER_SCREEN = 8  # candidates of a round that are fitted to their optimum
SAME_NATS = 0.5  # of two fits of one family and owner, screened: nearer, they are one
OPEN_WELLS = 2  # of what was found before, beside which candidates are screened too, the likeliest
BEHIND_SHARE = 0.1  # of the best one's evidence: what promises less is not looked at from all its beginnings
FITTED_PER_FAMILY = 2  # of those, at most of one family: a crowd of neighbours leaves room for other physics
SCREENED_NATS = 1000.0  # of excess energy in thinned soundings: then candidates are screened on them
SCREENED_TIMES = 1, 2  # as many instants and frequencies as first guesses are ranked on, the fewest that have this energy
SCREEN_ROUNDS = 2  # Gauss-Newton steps of a candidate, alone or with what was found before
RESHAPED, SHAPE_NATS = 6, 2.0  # turns of looking for a shape, at most; what a turn must give for another
TRIMMED_NATS = 0.5  # that the end of an added object must be worth to be there
ASKED_AGAIN = 2  # of what came close to an effect, each time when another is found
SHAPE_SHARE = 0.01  # of what an added object explains, for what is wrong with its shape: less is no other's effect
SEPARATED_NATS = 10.0  # what a recording must promise to be worth asking for
LINK_NATS = 3.0  # of one link: less is no part of an effect's place
POSITIONS = 60  # that are tried for the next sounding
THIN_INSTANTS, THIN_FREQUENCIES = 7, 20  # of a sounding on which first guesses of one family are ranked
MANY_RESTARTS = 30  # are ranked on thinned soundings
WELLS = 8  # of the phase of a cause that are looked at for how far its numbers are open
WELL_STEPS, WELLS_AROUND = 16, 24  # places to a wavelength, and so many either way, at which such wells are looked for
WELL_SHARE = 0.05  # of the likelihood of all: less, and 95 % of it lie elsewhere
WAY_NATS = 30.0  # by which what passes by explains more than on any other way: two on the bench that were told on a wrong one
# had 0.5 and 18, those on the right one 600 and more
SAME_STEPS = 20  # of a numerical derivative: nearer minima are one
FULL_STARTS = 3  # first guesses of one family and owner that are fitted
CHOSEN_AGAIN = 6  # of somebody's ways that are found beside his own, those whose width is chosen
STILL_DEVIATIONS = 0.5  # of the energy of noise, above which a way is looked for again: a wrong one may leave little
DIFFUSE_SHARE, DIFFUSE_NUMBERS = 0.01, 0.02  # of the energy of scattered fields, of the numbers that they make: the less of both;
# their law is no nearer to what patches do
UNEVEN_DEVIATIONS = 3.5  # of the spread of a random field's modes: above, what it is to explain is something else. On the bench
# five fields that were there had 0.5 at most, three that were told and were others or none 3.8, 8 and 12
BESIDE_ROUGH_NATS = 30.0  # of an effect beside scattering, whose patches are no Gaussian noise, or edges, which are no wedges: up
# to 26 came from nothing
FIELDS_SHARE = 0.01  # of what fields explain, and less is theirs where the vault shows none of it: an object of 82 nats was told
# beside 9,000 of a panel that scatters, and none of the vault; an order of reflections of 280 beside 52,000 does, and was there
UNSOUNDED_NATS = 0.1  # by which the vault is otherwise with an effect: less, and it does not hear of it
STIFF_SHARE = (
    0.25  # of the excess energy, and of a random field's evidence, which something stiff explains: then random fields wait
)
MOST_SHARE = 0.5  # of that excess: then they wait even where one of them leaves nothing
SAME_SHARE = 0.9  # of what several effects explain together, which one thing that is screened must explain to be in their place
LONE_LINKS = 3  # that tell of a cause of the whole place, which something that stands somewhere may be too
CLOSE_REGRET = 0.3  # of the best candidate's evidence, by which another is behind and still tried where the best led nowhere
FLEXIBLE_REGRET = 0.15  # of random fields, whatever they explain, and of something stiff that explains a good part beside them
QUIET_DEVIATIONS = 1.5  # of the energy of noise: below, wide searches for what moves by wavelengths are spared
RIVALS_SHARE = 0.15  # of the time of a search: a cause is told only beside what else it might have been. With two and three
# causes it took some seconds of 180, where 126 were too few to find them all
EDGE_SHARE = 0.5  # of the theory's strength by which an edge's may differ: slabs and corners are no half-planes
LOOSE_SHARE = 0.1  # of what edges gain so, for what strengths do not mend: on the bench two objects gained 33 nats beside 490
EDGE_NATS = 0.5  # of such a difference: below, an edge's strength is as the theory has it
REFUSED_SHARE = 0.1  # of what all effects together leave there, which may be another's fault
REFUSED_NATS = 10.0  # by which an effect makes soundings that it was not fitted to less likely: then it is none
CONFIRMED_SHARE = 0.5  # of what is left of the vault, which a small effect must explain to be told for that
UNTOLD_NOISE = 0.5  # of the vault's noise: what is left more is not predicted, unless it is no more than
UNTOLD_SHARE, UNTOLD_BY_FIELDS = 0.005, 0.02  # of what the twin leaves there; where random fields are told, which have no place:
# of 45 lists that were right on the bench none left more, of 15 wrong ones 9; none of 60 without fields left half the noise
RESETTLED_SHARE = 0.05  # of what the least effect explains of what was fitted, which numbers may lose that explain the vault too
UNTOLD_MOST, SEEN_DEVIATIONS = 0.9, 3.0  # of what the twin leaves there, where it is more than so many standard deviations of
# noise: a list that leaves so much tells none of it
SUREST = 0.98  # of a cause that nothing speaks against: of the last 54 so told on the bench every one was right
SURE_IF_REFUSED, SURE_IF_ELSEWHERE = 0.2, 0.4  # the vault speaks against what lasts (of 6 on the bench none was right), or
# against what may have gone another way then
SURE_IF_UNSHOWN = 0.8  # the vault shows none of it
SURE_IF_SPENT = 0.85  # the time ended before nothing more was found: of 46 so told on the bench 41 were right
SURE_IF_MANY = 0.8  # as many causes as are looked for: pieces of what was not found, more often than not
SURE_IF_LEFT, SURE_IF_FLEXIBLE = 0.6, 0.4  # something is left that nobody named; then, of what explains much that it is not
LEAST_SURE = 0.25  # of a cause that is told: of 30 on the bench that were less sure none was right
TAKEN_NATS, TAKEN_SHARE = 24.0, 0.01  # that what is not claimed explained, and of what is claimed: more is there, whatever it is
PATHLESS_SHARE = 0.01  # of the powers that are read where the twin has no path: more is something that nobody names
NARROW_BAND = 2e-3  # of the SPEC's band: soundings that span less of it are in kHz or MHz, more likely than not
WIDE_MESH_M, WIDE_MESH = 1000.0, 200.0  # m, and times what the nodes span: a mesh as wide is in mm, more likely than not
TURNED_SHARE = 0.1  # of what the twin leaves over noise, up to which it leaves it of the conjugates where a sign is wrong,
TURNED_LINKS, TURNED_TONES = 2, 4  # of so many links and frequencies at least: one may look like it by chance
