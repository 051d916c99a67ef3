"""The diagnosis of a finished run: how good it is, where it fails, and which effect the model lacks.

diagnosis     the conclusions from a search; `unknown_law` is what no effect explains, `noise` what noise does
advice        what to record or to look for; `separability` are the drives that tell effects apart
status        green, yellow or red, in one sentence
json_summary  results as JSON
settings      all thresholds

The rooms; each imports only from those above it:

analysis      one run: its drift, where it fails, what its score statistics say of each candidate effect
search        add the best explanation, run again; what was added is tested beside all others
laws          unknown laws: learned as curves, memories and maps, and rewritten in closed form
series        numbers for reports and pages

No module knows an effect by name: effects declare their properties (`effects.traits`).
"""
