"""Noise: as the settings say, and as a recording shows.

process_noise    what one block of gyro and wheels adds to the covariance
noise_bank       filters with other noise of the gyro, side by side
wheel_noise      noise of the wheels, learned from the images
stamp_noise      noise of the stamps of images
rest             standing still, and the noise of the gyro meanwhile
adaptive_noise   noise of measurements by their innovations
reference_noise  noise of a heading reference, which `reference_learner` learns by those of `reference_bank`
shared_noise     a heading reference that contains the gyro
"""
