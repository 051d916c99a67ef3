"""Calibrates the gyro of an indoor robot from its ceiling camera and finds what its model lacks.

The rooms, in the order in which the data flow:

    errors, data, files           what everybody uses: errors, the values that travel, writing
    settings, config, config_file all settings, declared once, and the files that hold them
    recording                     bags and their check: messages become measurements
    board                         the IMU and encoder board: its bytes become measurements
    sim                           the simulator: the same measurements, with the truth beside them
    vision                        the tracker: images become feature observations
    model                         the paper: rotations, kinematics, gyro, camera, feature parametrisations
    effects                       physical effects that a sensor model can be made of, one a file
    ekf                           the filter: one measurement at a time, the algorithm on one page in slam
    seeing                        the filter with the tracker before it
    calibrate, calibration        settings and a source become a finished run, and a run a calibration
    diagnose                      reads a finished run: what the calibration is worth
    report                        figures and tables of a finished run; computes nothing
    bench                         accuracy and speed over many simulated runs
    live                          what runs on the robot, without ROS: measurements as they arrive
    studio                        the web page on which a person finds what the model lacks
    cli                           the command `gyrocal`, one file a command
    nodes                         the ROS nodes: driver, tracker, calibrator
"""

__version__ = '0.1.0'
