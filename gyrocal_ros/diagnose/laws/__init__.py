"""Laws that no effect of the library has.

hypotheses     unknown laws, as columns for the filter to carry
learning       run the likeliest, keep what predicts better
closed_forms   from a curve or a memory to its law; `bump_fit` from a map to its bump
rewriting      closed forms take the place of curves
learned_laws   what was learned, for people
"""
