"""Numbers for reports and pages, which compute nothing.

run_series, model_series, search_series  a run, several models, the steps of a search
error_curves     the error left over as a function of a signal; `effect_axis` and `law_axis` say of which
failure_ranges   where a failure lies on the axes of the figures
"""
