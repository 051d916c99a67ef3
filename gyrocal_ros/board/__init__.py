"""The IMU and encoder board: its bytes become measurements. No ROS, no serial port.

messages   the wire table: what each message holds
protocol   bytes become packets and packets bytes
clock      the board's clock becomes the clock of the stamps
convert    counts become samples in SI units

`docs/board_protocol.md` is the same for the engineer who writes the firmware.
"""
