"""The IMU and encoder board: bytes to measurements, without ROS.

messages   wire table: the fields of each message
protocol   framing: bytes to packets and packets to bytes
clock      conversion of the board's clock to the host clock
convert    counts to samples in SI units; counts is the inverse
reader     the complete receive path: bytes and arrival times to readings
commands   commands to the board, repeated until they are acknowledged
link       the serial port; the only module here with IO

`docs/board_protocol.md` describes the same protocol for the engineer who writes the firmware.
"""
