"""Features: which to believe, how exactly they are seen, and what an image tells of their places.

image_model      where features are expected
landmarks        features join the map and leave it; `admission` says which may join
gating           outliers; features are compared with the map (`judged`) and by each other (`robust`)
known_depth      depths that become known; `anchors` are the places from which features were first seen
considered       effects that wait until the camera moves; `certain_way`: a way by the wheels that is noise
feature_noise    noise of each feature; `track_noise` is what a run learns of it
slow_errors      errors of tracks that change with the view; `repeated_errors` stay while the picture does
moving_features  no fixed points; nor those of `sliding`, `contradictions` and `resting_view`
near_features    nearer than any ceiling
turning_view     images that turn with the camera; `frozen_camera` finds those that repeat
way_agreement    the way by the wheels, and that by the features
image_heading    the innovation of an image as an error of the heading
"""
