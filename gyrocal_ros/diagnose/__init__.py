"""The diagnosis of a finished run: how good it is, where it fails, and which effect the model lacks.

summarise        what a recording holds            search           add the best explanation, run again
candidates       effects to try                    diagnosis        the conclusions from a search
candidate_fit    fits to score statistics          improvement      the revisions of a search
profile          scanned coefficients              advice           what to record or to look for
ranking          the best explanation              separability     drives that tell effects apart
limits           saturation and dead band          settings         all thresholds
heading_filter   headings by gyro and camera       drift            blind drift of a run
regimes          where the model fails             comparison       several models on one recording
shapes           unexplained structure             predictive_gain  predictive log-likelihood
hypotheses       unknown laws, as columns          learning         run the likeliest, keep what helps
closed_forms     from a curve to its law           learned_laws     what was learned, for people

Numbers for reports and pages: run_series, search_series, model_series, error_curves, wander, json_summary.
No module knows an effect by name: effects declare their properties (`effects.traits`).
"""
