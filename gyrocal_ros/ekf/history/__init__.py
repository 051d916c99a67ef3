"""The history of a run, and its statistics.

step_record        record of one step
run                all of them as arrays: the input of diagnosis and reports
score_statistics   score statistics of candidate effects; `feature_likelihoods` are those of the features
convergence        the scale factor is known well enough
scatter            scatter of the estimates over stretches of a run
turn_agreement     turns by gyro, wheels and images
growing            columns that grow row by row
"""
