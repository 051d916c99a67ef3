"""Benchmarks of the package on simulated robots, whose truth is known.

accuracy      scale factor, consistency and heading over many seeds; `bench_run` runs one seed
methods       comparison with other ways of calibrating; `naive` and `batch` implement them
camera_off    heading and position without the camera
blind         diagnosis of hidden effects
separability  information of each test drive on each effect
eyes          accuracy from images of difficult scenes
tracker       the feature tracker alone
speed         time and memory; `growth` against the size of the problem
gate          figures that are compared with kept ones after each change of the code
paper         the figures and the table of the paper
"""
