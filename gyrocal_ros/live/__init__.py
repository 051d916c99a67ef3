"""What runs on the robot, without ROS: measurements come in as they arrive, estimates go out at once.

The nodes are shells round these; nothing here knows of messages or topics.

board_driver, board_health   reads the board, finds it again when it was lost, and tells how it is
emulator                     a board that is none: emulator_board at the end of an emulator_line,
                             played on a pseudo-terminal by emulator_pty
"""
