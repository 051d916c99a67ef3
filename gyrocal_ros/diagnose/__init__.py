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

No module knows an effect by name: effects declare their properties (`effects.traits`).
"""
