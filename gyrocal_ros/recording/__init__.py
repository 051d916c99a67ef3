"""Bags, in and out.

storage        opens the files                      topics     messages become values
fields         reads a few fields of a message      messages   values become messages
selection      which topic plays which role         images     the same for images
rig            how the sensors sit                  reorder    sorting by stamps
decode, bag    the source of measurements           write      the writer
watch, stats   figures of one quick pass            judge      what they mean
check          the report                           findings   what a person should know
"""
