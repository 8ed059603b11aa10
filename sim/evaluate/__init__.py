"""How good the localizer is: many simulated cases, what became of each, and what that adds up to."""
