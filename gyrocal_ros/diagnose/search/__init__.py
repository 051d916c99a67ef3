"""The search for what a model lacks.

search       run the filter, add the best explanation, run it again
additions    the steps of a search; `improvement` has them as revisions
one_more     runs with one more effect; `several` are effects that explain only together
elimination  backward elimination; `alternatives` are other combinations
uneven       effects of some stretches only; `traces` are too small, `look_alikes` are listed with those found
limit_runs   runs with a saturation or a dead band; `limit_sizes` tries their sizes
thermometer  the temperature in place of the time since power-on
noise_fit    noise that makes the headings likeliest
timing       faults of the stamps
recovery     runs in which the filter diverges
"""
