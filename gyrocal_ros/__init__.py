"""Calibrates the gyro of an indoor robot from its ceiling camera, and finds effects that its model lacks.

The rooms, in six bands. A room imports from its own band and from the bands below.

    edge   cli         the command `gyrocal`
           nodes       the ROS nodes: driver, tracker, calibrator
           studio      the web page for the diagnosis of a recording
    robot  robot       what runs on the robot, without ROS: live calibrator, dead reckoning, health
    lab    pipeline    settings, model and source become a run, and a run becomes a calibration
           diagnose    accuracy of a finished run, where it fails, which effect its model lacks
           report      pages and figures; computes nothing
           sim         simulated robots: measurements with ground truth
           fleet       many bags of many robots: spread, ageing, missing effects, priors
           emulator    an emulated board and ceiling camera
           bench       accuracy, speed and diagnosis on simulated robots; the figures of the paper
    io     bag         recorded bags: check, read, play, write
           msgs        ROS messages to values and back
           board       bytes of the IMU and encoder board to measurements
           vision      images to features
    core   ekf         the filter; `ekf.slam` is the algorithm on one page
           effects     physical effects that a sensor model can contain, one file each
           model       equations of the paper: kinematics, gyro, camera, features
           statistics  tests and distributions
    base   config      all settings, declared once
           data        the values that the rooms exchange, with units and shapes
           errors      errors with place and remedy
           files       files that appear complete or not at all
           kernels     compiled twins of the filter's inner loops, where they were built
"""

__version__ = '0.1.0'
