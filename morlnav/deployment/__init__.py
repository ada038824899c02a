"""Trained policies on a robot: loading, preferences by context, export."""
