"""The diagnosis of a finished run: how good it is, where it fails, and which effect the model lacks.

summarise        what a recording holds         search           add the best explanation, run again
candidates       effects to try                 examined         one model on a recording
candidate_fit    fits to score statistics       additions        the steps of a search
profile          scanned coefficients           elimination      test all effects again, together
ranking          the best explanation           diagnosis        the conclusions from a search
limits           saturation and dead band       improvement      the revisions of a search
noise            noise as an explanation        advice           what to record or to look for
heading_filter   headings by gyro and camera    separability     drives that tell effects apart
regimes          where the model fails          settings         all thresholds
shapes           unexplained structure          drift            blind drift of a run
hypotheses       unknown laws, as columns       comparison       several models on one recording
closed_forms     from a curve to its law        predictive_gain  predictive log-likelihood
model_fit        whether a model fits at all    learning         run the likeliest, keep what helps
timing           faults of the time stamps      learned_laws     what was learned, for people
rewriting        learned laws in closed form     bump_fit         from a map to its bump
unknown_law      which law is left unexplained   recovery         runs where the filter diverges

Numbers for reports and pages: run_series, search_series, model_series, error_curves, wander, json_summary.
No module knows an effect by name: effects declare their properties (`effects.traits`).
"""
