"""Prediction of the skyline from a place, for planning a trip and for checking an elevation model."""
