"""The figures and the table of Lee et al. 2012, made anew with this package's simulator and estimator.

An experiment is a function of a mapper and a number of seeds; what it returns is numbers alone.
"""
