"""The IMU and encoder board: its bytes become measurements. No ROS.

messages   the wire table: what each message holds
protocol   bytes become packets and packets bytes
clock      the board's clock becomes the clock of the stamps
convert    counts become samples in SI units; counts goes the other way
reader     all of these in a row: bytes and their arrivals become readings
commands   what the board has to be told, until it has answered
link       the serial line; all else here is without IO

`docs/board_protocol.md` is the same for the engineer who writes the firmware.
"""
