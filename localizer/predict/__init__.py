"""The skyline that a camera would see from a place, for planning a trip and for checking an elevation model."""
