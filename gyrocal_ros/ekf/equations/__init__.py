"""The equations of the filter.

predict            state and covariance over a block of samples
update             measurement updates
effects_by_place   the effects of the sensor model, where they act in both
heading            updates by a heading reference
levelling          gravity bounds roll and pitch where no camera does
steady_rate        the rate without its noise, where it is steady
feature_scores     score statistics by feature
"""
