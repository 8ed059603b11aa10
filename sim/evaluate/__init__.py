"""Evaluation of the localizer: many simulated cases, their results, and summary statistics."""
