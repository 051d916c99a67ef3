"""The studio: a web page for the diagnosis of a recording, and the state machine behind it.

recordings    what a session works on: a bag or a hidden-effect task
tasks         long work as values: tasks and messages
executor      execution of the tasks
worker        the process that executes them
session       the actions of a user on one recording; `state` is its state as a value
revisions     the models that were tried
store         the folder of a session
lesson        the hidden effects compared with the estimates
workspace     the recordings of a studio and the open session

layout        layout of the page             panels     texts and tables
callbacks     updates of the page, buttons   pictures   figures
export        the report of a session        live_page  the page about a running robot
server        serves the page and controls access

The first group does not depend on the browser.
"""
