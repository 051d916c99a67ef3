"""An emulated board and ceiling camera, fed from a simulated robot or a recorded bag.

schedule   events of the board in time order   line       the serial line: delay, jitter, faults
board      frames and commands of the board    terminal   real-time play on a pseudo-terminal
camera     images of a simulated robot
"""
