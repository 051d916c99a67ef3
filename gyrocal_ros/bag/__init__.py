"""Recorded bags: reading, checking, playing back and writing them. The only room that needs rosbags.

storage          opens the files                         source      a bag as a source of measurements
fields           reads a few fields of a message         decode      messages become measurements
selection        which topic plays which role            rig         geometry of the robot
scan, topic_stats  figures of one quick pass             assess      problems that the figures show
check            the report of a bag's problems          write       the writer
playback         messages as a running robot sends them
"""
