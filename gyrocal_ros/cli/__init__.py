"""The command `gyrocal` and the program `board_emulator`.

main              finds the module of a command, runs it, reports errors
one module each   the commands, with their names, and `board_emulator`
options           options shared by several commands; also `model_options` and `scenario_options`
bag_runs          several runs of the filter over one bag
figures           the options --png and --pdf
output            progress, messages, tables, JSON
provenance        version and machine of a benchmark
reproduce_page    the page of `gyrocal reproduce`
"""
