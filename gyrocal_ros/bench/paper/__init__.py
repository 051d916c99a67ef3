"""Reproduction of the figures and the table of Lee et al. 2012 by simulation.

An experiment is a function of a mapper and a number of seeds; it returns numbers only.
"""
