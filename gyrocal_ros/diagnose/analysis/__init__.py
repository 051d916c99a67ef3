"""Analysis of one run.

examined        a model on a recording, and what the recording says that it lacks
drift           blind drift; `validation` is that on another recording, `wander` its course
model_fit       whether a model fits at all; `predictive_gain` compares two
heading_filter  headings by gyro and camera
regimes         where the model fails; `shapes` is what the error follows
candidates      effects to try; `candidate_fit` fits them to score statistics, `profile` their time constants
ranking         the best explanation
limits          saturation and dead band in the readings
late_images     stamps that are far off
summarise       what a recording holds; `signal_ranges` are those of its signals
comparison      several models on one recording
"""
