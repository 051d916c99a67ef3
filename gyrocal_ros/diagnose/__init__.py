"""Criticism of a finished run: how good it is and where it fails."""
