"""When marks on the lens are reported. Apart from `lens_marks`, which finds them and needs OpenCV."""

LIFETIME_S = 300.0
"""Time after which a mark is forgotten; dust that is still there is soon found again."""
MANY_MARKS = 8
"""Marks within `LIFETIME_S` that are reported; a few points of a ceiling are mistaken for marks."""
MANY_MARKS_TEXT = (
    'many features stay in the image while most of it changes; '
    'clean the lens, and keep parts of the robot out of view'
)
