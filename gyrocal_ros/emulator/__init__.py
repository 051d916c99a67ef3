"""An emulated board and ceiling camera, fed from a simulated robot or a recorded bag.

schedule   what the board sends, and when       line       the serial line: delay, jitter, faults
board      frames and commands of the board     terminal   plays it on a pseudo-terminal
camera     images of a simulated robot
"""
