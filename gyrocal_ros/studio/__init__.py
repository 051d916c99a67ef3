"""The web page on which a person finds the missing physics, and the state machine behind it.

`session` knows what a person has done and `worker` does the long work in a process of its own; neither
knows of a browser. `page` lays the screen out, `pictures` fills it, `server` guards the door.
"""
