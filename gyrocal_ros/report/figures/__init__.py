"""The figures: data in, figure out; nothing is computed here, and plotly is known nowhere else."""
