"""Recorded bags: reading, checking, playing and writing. The only room that imports rosbags.

storage      opens the files                          source       a bag as a source of measurements
fields       reads a few fields of a message          decode       messages to measurements
selection    selects the topic of each role           rig          geometry of the robot
scan         collects statistics in one pass          topic_stats  statistics of one topic
assess       issues derived from the statistics       check        report on a bag
playback     messages as a running robot sends them   write        writes a bag
"""
