"""How well skylines are found in real photographs and in another engine's pictures, and places by them."""
