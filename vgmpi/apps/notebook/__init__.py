"""Runs for notebooks and scripts: frames, tables and pictures of a run's folder."""
